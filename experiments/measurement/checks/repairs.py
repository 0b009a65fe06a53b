"""Hypotheses of what was done to a log's columns, each written as what undoes it.

A column that was swapped, flipped, rescaled or shifted in time is put right by swapping, flipping, rescaling or
shifting it again.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np

from experiments.measurement.checks.links import Column, Columns
from experiments.measurement.checks.matching import Array
from experiments.measurement.logs.units import CONVERSIONS

Kind = Literal["sign", "unit", "time_shift", "swapped_joints", "swapped_axes", "quaternion", "unrelated"]


class Origin(NamedTuple):
    """What a column becomes: another column's rows from `ahead` samples later, times a factor."""

    column: Column
    factor: float = 1.0
    ahead: int = 0


@dataclass(frozen=True)
class Repair:
    """One hypothesis; of `unrelated` nothing can be undone.

    `names` are the joints, legs or axes concerned, `value` the factor or the samples of delay.
    """

    kind: Kind
    signals: tuple[str, ...]
    names: tuple[str, ...]
    value: float
    changes: Mapping[Column, Origin]

    def applied(self, columns: Columns) -> dict[Column, Array]:
        """The columns that change, undone."""
        return {column: _made(columns, origin) for column, origin in self.changes.items()}


# Signals that are likely to go wrong together: one sensor, one side of the spring, one device, everything of a joint
MEASURED: Final = (
    "joint_position",
    "joint_velocity",
    "motor_position",
    "motor_velocity",
    "joint_torque",
    "motor_current",
    "applied_torque",
)
COMMANDS: Final = ("command_torque", "command_position")
_SENSORS: Final = tuple((signal,) for signal in (*MEASURED, *COMMANDS))
# all that is measured, late, is the same as the commands, early
SHIFT_GROUPS: Final = (*_SENSORS, ("joint_position", "joint_velocity"), ("motor_position", "motor_velocity"))
JOINT_GROUPS: Final = (*SHIFT_GROUPS, COMMANDS, MEASURED, (*MEASURED, *COMMANDS))
UNIT_GROUPS: Final = (
    *_SENSORS,
    ("joint_position", "joint_velocity"),
    ("motor_position", "motor_velocity"),
    ("joint_position", "motor_position"),
    ("joint_velocity", "motor_velocity"),
    ("joint_position", "motor_position", "command_position"),
    ("joint_position", "joint_velocity", "motor_position", "motor_velocity"),
    ("joint_position", "joint_velocity", "motor_position", "motor_velocity", "command_position"),
    ("joint_torque", "command_torque"),
    ("joint_torque", "applied_torque", "command_torque"),
)
BASE: Final = (
    "base_position",
    "base_orientation",
    "base_linear_velocity",
    "base_angular_velocity",
    "base_acceleration",
)
BASE_GROUPS: Final = (
    *((signal,) for signal in BASE),
    ("base_position", "base_orientation", "base_linear_velocity"),
    ("base_angular_velocity", "base_acceleration"),
    BASE,
)
_UNITS: Final = {
    **dict.fromkeys(("joint_position", "motor_position", "command_position"), "rad"),
    **dict.fromkeys(("joint_velocity", "motor_velocity", "base_angular_velocity"), "rad/s"),
    **dict.fromkeys(("joint_torque", "applied_torque", "command_torque"), "N m"),
    "motor_current": "A",
    "base_position": "m",
    "base_linear_velocity": "m/s",
}


def flip(signals: tuple[str, ...], names: Iterable[str], there: Columns) -> Repair | None:
    """Signs turned over."""
    columns = _present(signals, names, there)
    return _repair("sign", columns, -1.0, {column: Origin(column, -1.0) for column in columns})


def rescale(signals: tuple[str, ...], names: Iterable[str], factor: float, there: Columns) -> Repair | None:
    """Values that are `factor` times what they should be."""
    columns = _present(signals, names, there)
    return _repair("unit", columns, factor, {column: Origin(column, 1.0 / factor) for column in columns})


def shift(signals: tuple[str, ...], names: Iterable[str], late: int, there: Columns) -> Repair | None:
    """Values that stand `late` rows after where they belong."""
    columns = _present(signals, names, there)
    return _repair("time_shift", columns, late, {column: Origin(column, 1.0, late) for column in columns})


def swap(signals: tuple[str, ...], one: str, other: str, there: Columns) -> Repair | None:
    """Columns of two joints or two axes exchanged."""
    both = [signal for signal in signals if (signal, one) in there and (signal, other) in there]
    changes = {}
    for signal in both:
        changes[signal, one] = Origin((signal, other))
        changes[signal, other] = Origin((signal, one))
    kind: Kind = "swapped_axes" if signals[0] in BASE else "swapped_joints"
    return _repair(kind, list(changes), 0.0, changes)


def swap_legs(signals: tuple[str, ...], one: str, other: str, joints: tuple[str, ...], there: Columns) -> Repair | None:
    """All joints of two legs exchanged."""
    changes: dict[Column, Origin] = {}
    for joint in joints:
        pair = swap(signals, f"{one}_{joint}", f"{other}_{joint}", there)
        changes |= pair.changes if pair else {}
    return _repair("swapped_joints", list(changes), 0.0, changes)


def reorder_quaternion(there: Columns) -> Iterator[Repair]:
    """The scalar part stood last; or the quaternion turned from world to torso."""
    parts = [("base_orientation", part) for part in "wxyz"]
    if set(parts) <= set(there):
        w, x, y, z = parts
        last = {w: Origin(z), x: Origin(w), y: Origin(x), z: Origin(y)}
        yield Repair("quaternion", ("base_orientation",), ("x y z w",), 0.0, last)
        inverse = {part: Origin(part, -1.0) for part in (x, y, z)}
        yield Repair("quaternion", ("base_orientation",), ("inverse",), 0.0, inverse)


def known_factors(signal: str, gear_ratio: float) -> set[float]:
    """Factors of the units that a signal is likely to be logged in. Any other may be a spring's or a sensor's doing."""
    units = CONVERSIONS.get(_UNITS.get(signal, ""), {})
    known = {1.0 / factor for factor in units.values() if factor != 1.0}
    known |= {units[unit] for unit in ("deg", "deg/s") if unit in units}  # turned into radians once too often
    # the motor's own side of the gear
    of_motor = {"motor_position": gear_ratio, "motor_velocity": gear_ratio, "joint_torque": 1.0 / gear_ratio}
    return known | {of_motor[signal]} if signal in of_motor else known


def _present(signals: tuple[str, ...], names: Iterable[str], there: Columns) -> list[Column]:
    return [(signal, name) for name in names for signal in signals if (signal, name) in there]


def _repair(kind: Kind, columns: list[Column], value: float, changes: Mapping[Column, Origin]) -> Repair | None:
    if not columns:
        return None
    signals = tuple(dict.fromkeys(signal for signal, _ in columns))
    names = tuple(dict.fromkeys(name for _, name in columns))
    return Repair(kind, signals, names, value, changes)


def _made(columns: Columns, origin: Origin) -> Array:
    values = columns[origin.column]
    if origin.ahead:
        rows = np.clip(np.arange(len(values)) + origin.ahead, 0, len(values) - 1)
        values = values[rows]
    return values * origin.factor if origin.factor != 1.0 else values
