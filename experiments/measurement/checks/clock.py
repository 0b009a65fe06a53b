"""Whether time runs as fast as the robot moves: all velocities against all changes of position."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from experiments.measurement.checks.faults import Fault
from experiments.measurement.checks.matching import Array
from experiments.measurement.logs.log import Log, si_unit
from experiments.measurement.logs.noise_floor import estimated
from experiments.measurement.logs.units import CONVERSIONS

_PAIRS: Final = (
    ("joint_position", "joint_velocity"),
    ("motor_position", "motor_velocity"),
    ("base_position", "base_linear_velocity"),
)
_ROWS: Final = 20  # over which a change of position is taken
_CLEAR: Final = 20.0  # times its noise has the change to be
_LEAST_COLUMNS: Final = 6
_ALIKE: Final = 0.1  # share by which the columns may differ
_MOST_APART: Final = 0.1  # share of the columns that may differ more
_OFF: Final = 0.2  # share by which time has to be wrong; a clock that is a little off shows nowhere
_SAME_FACTOR: Final = 0.03
_PERIODS: Final = (1e-5, 0.05)  # s: a log of a robot's joints is neither faster nor slower


def clock_faults(log: Log) -> Iterator[Fault]:
    """Velocities that are all by one factor too large or too small: not they are wrong, but time."""
    if log.joint is not None:
        return
    sides = [found for pair in _PAIRS if len(found := _factors(log, *pair))]
    factors = np.concatenate(sides) if len(sides) > 1 else np.zeros(0)
    if len(factors) < _LEAST_COLUMNS:
        return
    factor = float(np.median(factors))
    apart = np.abs(factors / factor - 1.0) > _ALIKE if factor > 0 else np.ones(1)
    if apart.mean() > _MOST_APART or abs(np.log(factor)) < np.log1p(_OFF):
        return
    on_base = len(sides) > 2
    if _is_unit(factor) and not on_base and _PERIODS[0] < log.sample_period < _PERIODS[1]:
        return  # of all velocities or of all positions
    message = (
        f"positions and velocities agree for rows that are {log.sample_period / factor:.3g} s apart, not "
        f"{log.sample_period:g} s: time is in another unit or rows were left out; correct time and sample_period."
    )
    yield Fault("time", "time", message)


def _factors(log: Log, position: str, velocity: str) -> Array:
    """Velocity over the rate of the position, for each column that moves enough."""
    p, v = log.signals.get(position), log.signals.get(velocity)
    if p is None or v is None or log.rows < 3 * _ROWS:
        return np.zeros(0)
    found = []
    for name in p.names:
        if name not in v.names:
            continue
        at, speed = p.column(name), np.nan_to_num(v.column(name), posinf=0.0, neginf=0.0)
        moved = at[_ROWS:] - at[:-_ROWS]
        travel = np.cumsum(0.5 * (speed[1:] + speed[:-1])) * log.sample_period
        travelled = np.concatenate([travel[_ROWS - 1 : _ROWS], travel[_ROWS:] - travel[:-_ROWS]])
        there = np.isfinite(moved)
        if there.any() and moved[there].std() > _CLEAR * estimated(at[:, None]):
            found.append(float(moved[there] @ travelled[there] / (moved[there] @ moved[there])))
    return np.array(found)


def _is_unit(factor: float) -> bool:
    """Whether positions or velocities in another known unit would give this factor."""
    known = [1.0 / f for f in CONVERSIONS[si_unit("joint_velocity", None)].values()]
    known += list(CONVERSIONS[si_unit("joint_position", None)].values())
    return any(abs(factor / one - 1.0) < _SAME_FACTOR for one in known)
