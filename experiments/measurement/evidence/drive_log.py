"""What a replay of the drives needs from a log, as arrays on the log's own rows."""

from typing import NamedTuple

import numpy as np

from experiments.errors import UserError
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
    q = _held(log.joints("joint_position"))
    torque, position = log.joints("command_torque"), log.joints("command_position")
    if torque is None and position is None:
        raise UserError(f"{log.name}: no command was logged; add command_torque or command_position.")
    nothing = np.full_like(q, np.nan)
    torque = nothing if torque is None else torque
    position = nothing if position is None else position
    mode = np.where(np.isfinite(torque), 0.0, 1.0)
    tau = _held(log.joints("joint_torque"))
    theta = _held(log.joints("motor_position"))
    tables = (
        np.nan_to_num(torque),
        np.where(np.isfinite(position), position, q),
        mode,
        q,
        _velocity(log, "joint_velocity", q),
        tau,
        theta,
        _velocity(log, "motor_velocity", theta),
        np.zeros_like(q) if log.joints("motor_current") is None else _held(log.joints("motor_current")),
    )
    told = channels_logged(log)[:, 0]
    return DriveLog(*(np.asarray(np.where(told, table, 0.0), np.float32) for table in tables))


def _velocity(log: Log, signal: str, position: np.ndarray) -> np.ndarray:
    """As measured, the gradient of the position of joints of which it was not."""
    gradient, measured = np.gradient(position, log.sample_period, axis=0), log.joints(signal)
    return gradient if measured is None else np.where(_logged(log, signal), _held(measured), gradient)


def _held(table: np.ndarray) -> np.ndarray:
    """Holds the last value over single missing samples, the first one backwards; zeros where nothing was logged."""
    known = np.isfinite(table)
    index = np.where(known, np.arange(len(table))[:, None], -1)
    index = np.maximum.accumulate(index, axis=0)
    first = np.argmax(known, axis=0)
    index = np.where(index < 0, first[None, :], index)
    return np.nan_to_num(np.take_along_axis(table, index, axis=0))
