"""A gait that takes more care where it must: on steep ground, and while something carries or turns the torso away.

What a gait with flights is good for on the level, strikes hard and steers little: on a slope, under a push and when it
stumbles it goes over to a form of itself that keeps its feet on the ground. As between any two gaits every number of
the controller is interpolated (PAPER V.A.1; LOCO blends its gaits so). Where the footfalls come in another order, as
between a bound and a trot, they shift by up to half a stride meanwhile: that must take longer than a stride (`rise`).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from controller_jax import locomotion
from controller_jax.locomotion import GaitParams, LocomotionInfo, LocomotionState
from controller_jax.rotations import TINY, cross
from controller_jax.types import Array, JointTargets, LegGeometry, RobotState
from controller_jax.velocity_command import VelocityCommand


class CautionParams(NamedTuple):
    """When care is taken, from none to all."""

    slope: Array  # (2,) of the ground, rad
    excess: Array  # (2,) speed along the ground beyond the commanded one, m/s
    tilt: Array  # (2,) of the torso against the ground, rad
    rise: Array  # () s from none to all, > 0
    calm: Array  # () s from all to none, > 0


class CarefulGait(NamedTuple):
    """Both forms of a gait."""

    usual: GaitParams
    careful: GaitParams
    caution: CautionParams


class CarefulState(NamedTuple):
    """What the scan carries."""

    gait: LocomotionState
    caution: Array  # () 0 usual, 1 careful


def init(params: CarefulGait, geometry: LegGeometry, robot: RobotState) -> CarefulState:
    """The robot stands on all legs, with the care that the ground under its feet asks for."""
    gait = locomotion.init(geometry, robot)
    return CarefulState(gait, asked_caution(params.caution, gait, robot))


def step(
    params: CarefulGait,
    geometry: LegGeometry,
    state: CarefulState,
    robot: RobotState,
    command: VelocityCommand,
    time: Array,
    period: Array,
) -> tuple[CarefulState, JointTargets, LocomotionInfo]:
    """One control period (s) of the gait between its two forms; otherwise as locomotion.step."""
    change = asked_caution(params.caution, state.gait, robot) - state.caution
    caution = state.caution + jnp.clip(change, -period / params.caution.calm, period / params.caution.rise)
    between = jax.tree.map(lambda usual, careful: usual + caution * (careful - usual), params.usual, params.careful)
    gait, targets, info = locomotion.step(between, geometry, state.gait, robot, command, time, period)
    return CarefulState(gait, caution), targets, info


def asked_caution(params: CautionParams, gait: LocomotionState, robot: RobotState) -> Array:
    """Care () from 0 to 1 that the ground, the torso's speed or its tilt asks for, whichever asks for most."""
    normal, v_W = gait.plane.normal_W, robot.v_WB
    along = v_W - (v_W * normal).sum() * normal
    commanded = jnp.sqrt(gait.command.heading**2 + gait.command.lateral**2 + TINY)
    excess = jnp.sqrt((along * along).sum() + TINY) - commanded
    # sines for the angles: the difference is 3 % at 25 degrees
    steep = jnp.sqrt(normal[0] ** 2 + normal[1] ** 2 + TINY)
    tilt = jnp.sqrt((cross(normal, robot.R_WB[:, 2]) ** 2).sum() + TINY)
    asked = (_share(params.slope, steep), _share(params.excess, excess), _share(params.tilt, tilt))
    return jnp.stack(asked).max()


def _share(limits: Array, value: Array) -> Array:
    """0 at the first limit (2,) and below, 1 at the second and above, linear between."""
    return jnp.clip((value - limits[0]) / (limits[1] - limits[0]), 0.0, 1.0)
