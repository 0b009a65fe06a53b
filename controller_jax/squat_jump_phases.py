"""Phases of the squat jump: crouch, launch, flight, landing, and what makes one follow the other (V.C.2)."""

from typing import Final, NamedTuple

import jax.numpy as jnp

from controller_jax.force_distribution import DistributionState
from controller_jax.squat_jump_settings import SquatJumpSettings
from controller_jax.types import Array, RobotState
from controller_jax.virtual_model import Integrals

CROUCH: Final = 0.0
LAUNCH: Final = 1.0
FLIGHT: Final = 2.0
LANDING: Final = 3.0

RISING: Final = 0.2  # m/s upwards: feet without load below this are no take-off
OVERTIME: Final = 0.1  # s after the launch window for a take-off; later the robot just stands up


class SquatJumpState(NamedTuple):
    """What the scan carries."""

    phase: Array  # () CROUCH, LAUNCH, FLIGHT or LANDING
    phase_start: Array  # () s
    landed: Array  # (4,) 1.0 from a leg's first touch after the flight on
    ground: Array  # () height of the ground under the feet, world, m
    entry: Array  # (2,) height above ground, m, and its rate, m/s, when the phase began
    integrals: Integrals
    distribution: DistributionState


def advance(
    settings: SquatJumpSettings,
    state: SquatJumpState,
    robot: RobotState,
    feet_W: Array,
    time: Array,
) -> SquatJumpState:
    """Change of phase, contact and height of the ground, with the feet's centres (4, 3) at `time` (s)."""
    phase, elapsed = state.phase, time - state.phase_start
    touching = robot.contact.max() > 0.0
    rate = robot.v_WB[2]
    launch = (phase == CROUCH) & (time >= settings.crouch_time)
    leave = (phase == LAUNCH) & ~touching & (rate > RISING)
    touch = (phase == FLIGHT) & touching & (rate < 0.0)
    stay = (phase == LAUNCH) & (elapsed > settings.launch_time + OVERTIME) & ~leave
    changed = launch | leave | touch | stay
    phase = jnp.where(launch, LAUNCH, jnp.where(leave, FLIGHT, jnp.where(touch | stay, LANDING, phase)))

    landed = jnp.where(leave, 0.0, jnp.where(phase == LANDING, jnp.maximum(state.landed, robot.contact), state.landed))
    standing = landed.sum()
    soles = (landed * feet_W[:, 2]).sum() / jnp.maximum(standing, 1.0) - settings.geometry.foot_radius
    ground = jnp.where(standing > 0.0, soles, state.ground)
    entry = jnp.stack([robot.r_WB[2] - ground, rate])
    return state._replace(
        phase=phase,
        phase_start=jnp.where(changed, time, state.phase_start),
        landed=landed,
        ground=ground,
        entry=jnp.where(changed, entry, state.entry),
    )


def settled(settings: SquatJumpSettings, state: SquatJumpState, elapsed: Array) -> Array:
    """1.0 in the crouch, and once the time that a rise takes has passed since touch-down."""
    still = (state.phase == CROUCH) | ((state.phase == LANDING) & (elapsed > settings.rise_time))
    return still.astype(jnp.float32)
