"""Runs of equal values in a column: by chance, by a sensor that hangs, or by one at the end of its range."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from experiments.measurement.checks.matching import Array

_LEAST_STUCK: Final = 8  # rows
_AROUND: Final = 20  # rows before and after
_JUMP: Final = 3.0  # times the larger steps around
_TRAVEL: Final = 5e-3  # rad (or m) by which a joint has moved
_LEAST_FLAT: Final = 3  # rows
_CHANCE: Final = 1e-9  # that a run of equal values comes about by chance
_LONGER: Final = 3  # times the longest other run
# of the usual step between samples: a clipped signal is left at full speed, a turning point is not
_CORNER: Final = 0.3


@dataclass(frozen=True)
class Runs:
    """Starts and lengths (n,) of the runs of equal values of a column of `rows` values."""

    starts: Array
    lengths: Array
    rows: int

    @classmethod
    def of(cls, values: Array) -> Self:
        starts = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
        return cls(starts, np.diff(starts, append=len(values)), len(values))

    def improbable(self, length: int, others: Array) -> bool:
        """Whether a run this long does not come about by chance, given how the column repeats elsewhere."""
        repeats = float((others - 1).sum() + 1) / max(float(others.sum()), 1.0)
        return length > _LONGER * others.max(initial=1) and self.rows * repeats ** (length - 1) < _CHANCE


def is_stuck(runs: Runs, values: Array, moves: Array, dithers: bool) -> bool:
    """Whether the column hangs at a value while the quantity moves on: it leaves the run with a jump, the joint
    moves (T,) meanwhile by another sensor, or the sensor's noise exceeds its resolution and should go on."""
    steps = np.abs(np.diff(values))
    for place in np.flatnonzero(runs.lengths >= _LEAST_STUCK):
        start, length = int(runs.starts[place]), int(runs.lengths[place])
        stop = start + length
        around = np.concatenate([steps[max(start - 1 - _AROUND, 0) : max(start - 1, 0)], steps[stop : stop + _AROUND]])
        if len(around) < _AROUND:
            continue
        jump = stop < len(values) and steps[stop - 1] > _JUMP * np.percentile(around, 90)
        travel = float(np.ptp(moves[start:stop])) if len(moves) else 0.0
        repeats = 2.0 * (1.0 + (around == 0.0).sum()) / (2.0 + len(around))
        if (jump or travel > _TRAVEL or dithers) and runs.rows * min(repeats, 1.0) ** (length - 1) < _CHANCE:
            return True
    return False


def is_clipped(runs: Runs, values: Array, limit: float | None) -> bool:
    """Whether the column lies flat at its extreme, with corners where it leaves it. At the end of a log it hangs there.

    `limit`: a bound of the quantity itself, such as the current's, at which it may lie flat.
    """
    extremes = (values.min(), values.max())
    ordinary = runs.lengths[~np.isin(values[runs.starts], extremes)]
    for extreme in extremes:
        if limit is not None and abs(abs(extreme) / limit - 1.0) < 0.01:
            continue
        at = values[runs.starts] == extreme
        flat = at & (runs.lengths >= _LEAST_FLAT) & (runs.starts + runs.lengths < len(values))
        if flat.any() and runs.improbable(int(runs.lengths[flat].sum()), ordinary):
            if _has_corners(values, runs.starts[flat], runs.lengths[flat]):
                return True
    return False


def _has_corners(values: Array, starts: Array, lengths: Array) -> bool:
    """Whether most of these runs are entered or left at a good part of the usual speed."""
    steps = np.abs(np.diff(values))
    usual = float(np.median(steps[steps > 0]))
    before = np.where(starts > 0, steps[np.maximum(starts - 1, 0)], 0.0)
    ends = starts + lengths - 1
    after = np.where(ends < len(steps), steps[np.minimum(ends, len(steps) - 1)], 0.0)
    return bool((np.maximum(before, after) > _CORNER * usual).mean() > 0.5)
