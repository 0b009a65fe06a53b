"""What a replay of the drives needs from a log, as arrays on the log's own rows."""

from typing import NamedTuple

import numpy as np

from experiments.errors import UserError
from experiments.measurement.evidence.unlogged import held, measured_or
from experiments.measurement.logs.log import Log


class DriveLog(NamedTuple):
    """Commands and measurements of J series-elastic drives on T rows; every array (T, J), float32, SI."""

    command_torque: np.ndarray
    command_position: np.ndarray
    position_mode: np.ndarray
    joint_position: np.ndarray
    joint_velocity: np.ndarray
    joint_torque: np.ndarray
    motor_position: np.ndarray
    motor_velocity: np.ndarray
    motor_current: np.ndarray

    def joints(self, chosen: list[int]) -> "DriveLog":
        """Only some of the drives."""
        return DriveLog(*(table[:, chosen] for table in self))


NEEDED = ("joint_position", "joint_torque", "motor_position")


def has_drives(log: Log) -> bool:
    """Whether the log shows both sides of a spring and the commands of its drive."""
    commanded = log.joints("command_torque") is not None or log.joints("command_position") is not None
    return commanded and all(log.joints(signal) is not None for signal in NEEDED)


def channels_logged(log: Log) -> np.ndarray:
    """Which of the replay's channels (J, 3) a log tells of: of a joint that lacks a needed column or all commands
    none, of one that lacks its motor current not that."""
    needed = _logged(log, "command_torque") | _logged(log, "command_position")
    for signal in NEEDED:
        needed &= _logged(log, signal)
    return np.stack([needed, needed, needed & _logged(log, "motor_current")], -1)


def _logged(log: Log, signal: str) -> np.ndarray:
    """Joints (J,) of which the signal holds anything."""
    table = log.joints(signal)
    return np.zeros(len(log.joint_names), bool) if table is None else np.isfinite(table).any(0)


def drive_log(log: Log) -> DriveLog:
    """The drives' part of a log; raises UserError where a signal that the replay needs is missing.

    A joint of which it does not tell (`channels_logged`) rests at zero.
    """
    for signal in NEEDED:
        if log.joints(signal) is None:
            raise UserError(f"{log.name}: the drives cannot be replayed without '{signal}'; log it.")
    q = held(log.joints("joint_position"))
    torque, position = log.joints("command_torque"), log.joints("command_position")
    if torque is None and position is None:
        raise UserError(f"{log.name}: no command was logged; add command_torque or command_position.")
    nothing = np.full_like(q, np.nan)
    torque = nothing if torque is None else torque
    position = nothing if position is None else position
    mode = np.where(np.isfinite(torque), 0.0, 1.0)
    tau = held(log.joints("joint_torque"))
    theta = held(log.joints("motor_position"))
    tables = (
        np.nan_to_num(torque),
        np.where(np.isfinite(position), position, q),
        mode,
        q,
        measured_or(np.gradient(q, log.sample_period, axis=0), log.joints("joint_velocity")),
        tau,
        theta,
        measured_or(np.gradient(theta, log.sample_period, axis=0), log.joints("motor_velocity")),
        np.zeros_like(q) if log.joints("motor_current") is None else held(log.joints("motor_current")),
    )
    told = channels_logged(log)[:, 0]
    return DriveLog(*(np.asarray(np.where(told, table, 0.0), np.float32) for table in tables))
