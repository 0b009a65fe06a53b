"""Rows that are gone while time goes on evenly: positions all skip at one row against what their velocities say."""

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from experiments.measurement.checks.faults import Fault, counted
from experiments.measurement.checks.matching import Array
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.noise_floor import MAD_TO_STD

_GAP: Final = 1.5  # periods between two rows from which on the time itself tells that a row is missing
_JUMP: Final = 8.0  # robust standard deviations
_JUMPING: Final = 0.25  # share of the moving joints that have to jump together
_SKIPPED: Final = 0.5  # rows' worth of motion that a lost row exceeds and a late stamp does not
_AROUND: Final = 2  # rows on either side in which a lost row leaves nothing, unlike a velocity that is late
_ALONE: Final = 3.0  # times what stands around it


class _Side(NamedTuple):
    """What one side of the springs shows at each step from a row to the next."""

    jumping: Array  # share of the joints whose position jumps
    skipped: Array  # rows' worth of motion that it went further than its velocities say, by all joints
    clear: Array  # ... over its standard deviation


def lost_without_trace(log: Log) -> Iterator[Fault]:
    """Positions that jump, or skip a row's worth of motion, on both sides of the springs at once.

    A blow makes the links jump, but not the motors behind their springs: what is less than a jump, they have to show.
    """
    steps = np.diff(log.time)
    motors = _side(log, "motor", steps)
    sides = [side for side in (motors, _side(log, "joint", steps)) if side is not None]
    if not sides:
        return
    jumped = np.min([side.jumping for side in sides], axis=0) > _JUMPING
    skipped = np.min([side.skipped for side in sides], axis=0) > _SKIPPED
    skipped &= (motors.clear > _JUMP) & _alone(motors.clear) if motors is not None else False
    rows = np.flatnonzero((jumped | skipped) & (steps <= _GAP * log.sample_period))
    if rows.size:
        yield Fault(
            "dropped_samples",
            "time",
            f"positions jump against their velocities in {counted(rows.size, 'place')}, first at "
            f"{log.time[rows[0] + 1]:.6g} s: samples are missing there though the time goes on evenly; "
            "record the log again or cut it there.",
        )


def _side(log: Log, side: str, steps: Array) -> _Side | None:
    p, v = log.joints(f"{side}_position"), log.joints(f"{side}_velocity")
    if p is None or v is None:
        return None
    p, v = (np.where(np.isfinite(values), values, np.nan) for values in (p, v))
    speed = 0.5 * (v[1:] + v[:-1])
    surprise = np.diff(p, axis=0) - speed * np.minimum(steps, _GAP * log.sample_period)[:, None]
    judged = np.isfinite(surprise).mean(0) > 0.5
    if not judged.any():
        return None
    surprise, motion = surprise[:, judged], speed[:, judged] * log.sample_period
    spread = MAD_TO_STD * np.nanmedian(np.abs(surprise - np.nanmedian(surprise, axis=0)), axis=0)
    surprise, motion = surprise / np.maximum(spread, 1e-12), motion / np.maximum(spread, 1e-12)
    along, power = np.nansum(surprise * motion, axis=1), np.maximum(np.nansum(motion**2, axis=1), 1e-12)
    return _Side((np.abs(surprise) > _JUMP).mean(1), along / power, along / np.sqrt(power))


def _alone(clear: Array) -> Array:
    """Where a value exceeds by far all that stand around it."""
    padded = np.pad(np.abs(clear), _AROUND)
    around = [padded[k : k + len(clear)] for k in range(2 * _AROUND + 1) if k != _AROUND]
    return clear > _ALONE * np.max(around, axis=0)
