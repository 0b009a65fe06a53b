"""Series-elastic drives: joint controllers, velocity and current loops, motor, friction, spring (paper IV).

Every drive is `step(params, state, (command, measurement, motion), hooks, periods) -> (state, output)`.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from sea_jax.cheap_drive import cheap_drive
from sea_jax.friction import Friction
from sea_jax.full_drive import full_drive
from sea_jax.ideal_drive import ideal_drive
from sea_jax.initial_state import initial_state
from sea_jax.link_motion import link_motion, smoothed_link_motion
from sea_jax.parameters import (
    DriveParams,
    LoopPeriods,
    params_from_numbers,
    periods_from_numbers,
    select_joints,
    with_torque_limits,
)
from sea_jax.replay import ReplayRows, Timing, Trajectory, measured_start, replay
from sea_jax.types import (
    DriveHooks,
    DriveOutput,
    DriveState,
    JointCommand,
    JointMeasurement,
    JointMotion,
    Signals,
)

DRIVES: Mapping[str, Callable] = MappingProxyType({"full": full_drive, "cheap": cheap_drive, "ideal": ideal_drive})

__all__ = [
    "DRIVES",
    "DriveHooks",
    "DriveOutput",
    "DriveParams",
    "DriveState",
    "Friction",
    "JointCommand",
    "JointMeasurement",
    "JointMotion",
    "LoopPeriods",
    "ReplayRows",
    "Signals",
    "Timing",
    "Trajectory",
    "cheap_drive",
    "full_drive",
    "ideal_drive",
    "initial_state",
    "link_motion",
    "measured_start",
    "params_from_numbers",
    "periods_from_numbers",
    "replay",
    "select_joints",
    "smoothed_link_motion",
    "with_torque_limits",
]
