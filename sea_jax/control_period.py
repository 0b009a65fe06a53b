"""What all drives with a spring share at the start and the end of a control period."""

from typing import NamedTuple

import jax.numpy as jnp

from sea_jax.hooks import apply_hooks, no_signals
from sea_jax.joint_controllers import limited_velocity, wanted_velocity
from sea_jax.motor import spring_on_link
from sea_jax.parameters import DriveParams, LoopPeriods
from sea_jax.spring import deflection_at
from sea_jax.types import (
    Array,
    DriveHooks,
    DriveOutput,
    DriveState,
    JointCommand,
    JointMeasurement,
    JointMotion,
)


class PeriodStart(NamedTuple):
    """A control period about to run."""

    state: DriveState
    motion: JointMotion
    wanted: Array  # rad/s, before limits
    commanded: Array  # rad/s, after limits


class Link(NamedTuple):
    """The link at one instant, (J,)."""

    position: Array  # rad
    velocity: Array  # rad/s


def link_at(motion: JointMotion, time: Array) -> Link:
    """The link `time` seconds into the period, with constant acceleration."""
    turned = motion.acceleration * time
    return Link(motion.position + time * (motion.velocity + 0.5 * turned), motion.velocity + turned)


def initial_state(params: DriveParams, joint_position: Array, torque: Array, memory: dict | None = None) -> DriveState:
    """At rest with the spring carrying `torque`; current and integrators are those that hold it. All (J,).

    `memory` holds the start of the hooks' memories: {hook point: (one entry a hook, ...)}.
    """
    current = jnp.clip(
        torque / (params.gear_ratio * params.torque_constant), -params.current_limit, params.current_limit
    )
    return DriveState(
        motor_position=joint_position + deflection_at(params, torque),
        motor_velocity=jnp.zeros_like(joint_position),
        current=current,
        velocity_integral=current,
        current_integral=params.resistance * current,
        memory={} if memory is None else dict(memory),
    )


def begin_period(
    params: DriveParams,
    state: DriveState,
    inputs: tuple[JointCommand, JointMeasurement, JointMotion],
    hooks: DriveHooks,
    periods: LoopPeriods,
) -> PeriodStart:
    """Hooks of command and measurement, joint controllers and their limits."""
    command, measurement, motion = inputs
    signals = no_signals(motion.position, periods.control)._replace(
        motor_position=state.motor_position,
        motor_velocity=state.motor_velocity,
        current=state.current,
        joint_position=motion.position,
        joint_velocity=motion.velocity,
    )
    command, memory = apply_hooks(hooks, "command", command, signals, state.memory)
    measurement, memory = apply_hooks(hooks, "measurement", measurement, signals, memory)
    wanted = wanted_velocity(params, command, measurement)
    commanded = limited_velocity(params, wanted, measurement.torque)
    return PeriodStart(state._replace(memory=memory), motion, wanted, commanded)


def finish_period(
    params: DriveParams,
    state: DriveState,
    start: PeriodStart,
    hooks: DriveHooks,
    periods: LoopPeriods,
    period: float,
    tally: NamedTuple,
    count: int,
) -> tuple[DriveState, DriveOutput]:
    """Means over the `count` steps; the torque at the end is what the next step would put on the link."""
    end = link_at(start.motion, jnp.float32(periods.control))
    signals = no_signals(state.current, period)._replace(
        motor_position=state.motor_position,
        motor_velocity=state.motor_velocity,
        current=state.current,
        joint_position=end.position,
        joint_velocity=end.velocity,
    )
    end_torque, _, _ = spring_on_link(params, hooks, signals, state.memory)
    return state, DriveOutput(
        torque=tally.torque / count,
        damping=tally.damping / count,
        end_torque=end_torque,
        wanted_velocity=start.wanted,
        commanded_velocity=start.commanded,
        peak_current=tally.peak_current,
        peak_voltage=tally.peak_voltage,
    )
