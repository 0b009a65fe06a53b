"""Faults of the rows as such: time that does not run, another period, rows that are missing or stand there twice."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from experiments.measurement.checks.clock import clock_faults
from experiments.measurement.checks.faults import Fault, counted
from experiments.measurement.checks.lost_rows import lost_without_trace
from experiments.measurement.checks.matching import Array
from experiments.measurement.logs.log import SIGNALS, Log

LEAST_ROWS: Final = 20  # below, no check has anything to work on; what a fit needs, `gather` asks for
_PERIOD_OFF: Final = 0.02  # share by which the JSON's sample period may differ from the time stamps
_GAP: Final = 1.5  # periods between two rows from which on a row may be missing
_NEIGHBOURS: Final = 5  # rows on either side that tell a lost row from a late stamp
# A lost row or two can be bridged; a hole of 3 is a transient that nobody saw, and so is a log that leaks everywhere
_LONG_GAP: Final = 3
_LOST_SHARE: Final = 1e-3
_LEAST_REPEATS: Final = 3
_MORE_THAN_CHANCE: Final = 20.0
_MANY_COLUMNS: Final = 6
_HALF_THE_SAME: Final = 0.6  # share of columns; rows of a noisy log are either nearly all new or all old


def time_faults(log: Log) -> Iterator[Fault]:
    """The first fault of the time axis, then of the rows."""
    if log.rows < LEAST_ROWS:
        yield Fault("empty_log", "time", f"the log has {log.rows} rows, at least {LEAST_ROWS} are needed.")
        return
    if not np.isfinite(log.time).all():
        row = int(np.argmin(np.isfinite(log.time)))
        yield Fault("time", "time", f"row {row} has no time; write the time of every sample.")
        return
    steps = np.diff(log.time)
    if (steps < 0).any():
        at = f"{int((steps < 0).sum())} times, first after {log.time[np.argmax(steps < 0)]:.6g} s"
        yield Fault("time", "time", f"time runs backwards {at}; sort the rows by time.")
    elif (steps == 0).any():
        at = (
            f"{int((steps == 0).sum())} rows repeat the time before them, first {log.time[np.argmax(steps == 0)]:.6g} s"
        )
        yield Fault("repeated_samples", "time", f"{at}; delete what stands there twice.")
    else:
        rows = [*_period(log, steps), *_gaps(log, steps), *_repeated(log), *lost_without_trace(log)]
        rows = rows or list(clock_faults(log))
        yield from rows[:1]


def _period(log: Log, steps: Array) -> Iterator[Fault]:
    period = float(np.median(steps))
    factor = period / log.sample_period
    if abs(factor - 1.0) > _PERIOD_OFF:
        unit = {1e3: "in ms", 1e6: "in us", 1e9: "in ns"}.get(float(f"{factor:.1e}"))
        what = f"the column time is {unit}" if unit else f"the rows are {period:.6g} s apart"
        message = f"{what}, the JSON says sample_period {log.sample_period:g} s; correct the one or the other."
        yield Fault("unit" if unit else "time", "time", message)


def _gaps(log: Log, steps: Array) -> Iterator[Fault]:
    """Rows missing by their time stamps: the stamps after a gap stay late, those after a late stamp do not."""
    period = float(np.median(steps))
    late = log.time - log.time[0] - period * np.arange(log.rows)
    lost = {}
    for row in np.flatnonzero(steps > _GAP * period):
        before, after = late[max(row + 1 - _NEIGHBOURS, 0) : row + 1], late[row + 1 : row + 1 + _NEIGHBOURS]
        count = round(float(np.median(after) - np.median(before)) / period)
        if count > 0:
            lost[int(row)] = count
    total = sum(lost.values())
    if total and (max(lost.values()) >= _LONG_GAP or total > _LOST_SHARE * log.rows):
        yield Fault(
            "dropped_samples",
            "time",
            f"{counted(total, 'sample')} dropped in {counted(len(lost), 'place')}, up to {max(lost.values())} in a "
            f"row, first after {log.time[min(lost)]:.6g} s; cut the log there or record it again.",
        )


def _repeated(log: Log) -> Iterator[Fault]:
    """Rows in which every noisy sensor reads, to the last digit, what it read in the row before or in an older one."""
    values = [table.values for signal, table in log.signals.items() if is_measured(signal)]
    if not values:
        return
    values = np.concatenate(values, axis=1)
    values = values[:, np.isfinite(values).all(0)]
    same = values[1:] == values[:-1]
    telling = same.mean(0) < 0.5  # columns that often repeat, because they are coarse or slow, say nothing here
    if not telling.any():
        return
    values, same = values[:, telling], same[:, telling]
    share = same.mean(1)
    repeats = np.flatnonzero(share == 1.0) + 1
    if telling.sum() >= _MANY_COLUMNS:  # a few coarse columns may pass the same values again, noise in many never does
        _, first, which = np.unique(values, axis=0, return_index=True, return_inverse=True)
        repeats = np.flatnonzero(first[which.ravel()] < np.arange(log.rows))
    half = int(((share > _HALF_THE_SAME) & (share < 1.0)).sum())  # a robot at rest, logged without noise
    by_chance = log.rows * float(np.prod(np.maximum(same[share < 1.0].mean(0), 1.0 / log.rows)))
    if len(repeats) >= max(_LEAST_REPEATS, _MORE_THAN_CHANCE * by_chance, half):
        yield Fault(
            "repeated_samples",
            "time",
            f"{len(repeats)} rows repeat older ones in every sensor, first at {log.time[repeats[0]]:.6g} s; "
            "the logger wrote old samples again: delete them or record the log again.",
        )


def is_measured(signal: str) -> bool:
    """Whether a signal comes from a sensor with noise."""
    return not SIGNALS[signal].commanded and signal != "foot_contact"
