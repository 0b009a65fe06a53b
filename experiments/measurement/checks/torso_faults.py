"""Faults of the torso's sensors: a quaternion that is none, an accelerometer without gravity, contacts turned round."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

from experiments.measurement.checks.faults import Fault
from experiments.measurement.logs.log import Log

_UNIT_NORM: Final = 0.02  # a quaternion's norm strays by its noise, 1e-3, not by this
_CLAMPED: Final = 0.01  # m that a clamped torso may give way
_CARRIED: Final = 0.5  # of gravity: more than a torso feels whose legs swing in flight
_FLIGHTS: Final = 0.02  # share of rows without contact from which they are judged
_GRAVITY_OFF: Final = 3.0  # times; most of the time the ground carries the weight


def torso_faults(log: Log, numbers: Mapping[str, Any]) -> Iterator[Fault]:
    """What the torso's sensors show by themselves."""
    yield from _clamped(log)
    yield from _orientation(log)
    yield from _gravity(log, numbers)
    yield from _contact(log, numbers)


def _clamped(log: Log) -> Iterator[Fault]:
    """A torso that moves in an experiment that says it does not."""
    position = log.vector("base_position")
    if position is None or log.experiment != "fixed_base" or not np.isfinite(position).any():
        return
    low, high = np.nanpercentile(position, [0.5, 99.5], axis=0)
    if float((high - low).max()) > _CLAMPED:
        message = (
            f"the log's JSON says fixed_base, but base_position moves by {float((high - low).max()):.2g} m; "
            "a robot on the ground is experiment 'ground'."
        )
        yield Fault("experiment", "torso", message)


def _contact(log: Log, numbers: Mapping[str, Any]) -> Iterator[Fault]:
    """No foot on the ground, and yet the torso does not fall."""
    contact, acceleration = log.vector("foot_contact"), log.vector("base_acceleration")
    if contact is None or acceleration is None or log.experiment != "ground" or np.isnan(contact).any():
        return
    felt = np.linalg.norm(acceleration, axis=1)
    flying = (contact < 0.5).all(1) & np.isfinite(felt)
    carried = flying & (felt > _CARRIED * numbers["gravity"])
    if flying.mean() > _FLIGHTS and carried.sum() > 0.5 * flying.sum():
        message = (
            f"foot_contact says that no foot stands in {int(flying.sum())} rows, in most of which the torso does not "
            "fall; 1 is contact, 0 is none: turn it with 'scale = -1' and 'offset = 1' in a column map."
        )
        yield Fault("contact", "feet", message)


def _orientation(log: Log) -> Iterator[Fault]:
    quaternion = log.vector("base_orientation")
    if quaternion is None:
        return
    norm = float(np.nanmedian(np.linalg.norm(quaternion, axis=1)))
    if abs(norm - 1.0) > _UNIT_NORM:
        message = f"base_orientation is no unit quaternion (its norm is {norm:.3g}); the columns are w x y z."
        yield Fault("quaternion", "torso", message)


def _gravity(log: Log, numbers: Mapping[str, Any]) -> Iterator[Fault]:
    acceleration = log.vector("base_acceleration")
    if acceleration is None or log.joint is not None:
        return
    g, usual = numbers["gravity"], float(np.nanmedian(np.linalg.norm(acceleration, axis=1)))
    if not g / _GRAVITY_OFF < usual < g * _GRAVITY_OFF:
        message = (
            f"base_acceleration is {usual:.3g} on the average where a sensor at rest reads {g:g} m/s^2; "
            "log what the sensor reads, gravity included, and name its unit."
        )
        yield Fault("unit", "torso", message)
