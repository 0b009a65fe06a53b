"""One even time axis for all signals of a log: jitter taken out, slower sensors filled in, gaps left as gaps."""

from typing import Final

import numpy as np
from scipy.interpolate import PchipInterpolator

from experiments.errors import UserError
from experiments.measurement.logs.log import SIGNALS, Log, SignalTable

Array = np.ndarray

_EVEN: Final = 2e-3  # share of the period: closer to even than any signal can tell
_GAP: Final = 4.5  # distances between values from which on nobody knows what was between
_LATE: Final = 0.4  # share of the period by which a stamp may be late for its tick and the row still be of that tick
_MOST_ROWS: Final = 20_000_000


def is_even(log: Log) -> bool:
    """Whether the rows stand on an even grid of the log's sample period."""
    grid = log.time[0] + log.sample_period * np.arange(log.rows)
    return bool(np.abs(log.time - grid).max(initial=0.0) <= _EVEN * log.sample_period)


def resample(log: Log, period: float | None = None) -> Log:
    """The log on an even grid of `period` [s], by default its own sample period, from its first time stamp on.

    Measured signals are interpolated by monotone cubics, which do not overshoot, over single missing values too;
    commands and contacts are held. Values in a gap (more than 4.5 times the signal's own distance of samples) stay
    missing. A log that has nothing to be done is returned as it is. The time of the log has to increase. Raises
    UserError if the grid would be absurdly long.
    """
    period = period or log.sample_period
    if abs(period - log.sample_period) < 1e-9 and is_even(log) and not _has_holes(log):
        return log
    rows = (log.time[-1] - log.time[0]) / period + 1.0
    if not rows < _MOST_ROWS:
        raise UserError(
            f"{log.name} spans {log.time[-1] - log.time[0]:.3g} s, too long for samples every {period:g} s; correct "
            "the unit of its time with a column map, or cut it into several logs."
        )
    time = log.time[0] + period * np.arange(int(rows + 1e-6))
    tables = {signal: SignalTable(table.names, _resampled(log, signal, time)) for signal, table in log.signals.items()}
    return log.on_time(time, period, tables)


def _has_holes(log: Log) -> bool:
    """Whether single values of a sensor are missing."""
    measured = (table.values for signal, table in log.signals.items() if not SIGNALS[signal].commanded)
    return any(np.isnan(values).any() for values in measured)


def _resampled(log: Log, signal: str, grid: Array) -> Array:
    values = log.signals[signal].values
    if SIGNALS[signal].commanded or signal == "foot_contact":
        started = np.searchsorted(log.time - _LATE * log.sample_period, grid, side="right") - 1
        return values[np.maximum(started, 0)]
    if signal == "base_orientation":
        values = _continuous(values)
    result = np.stack([_interpolate(log.time, column, grid) for column in values.T], axis=1)
    if signal == "base_orientation" and result.shape[1] == 4:
        result /= np.linalg.norm(result, axis=1, keepdims=True)
    return result


def _interpolate(time: Array, column: Array, grid: Array) -> Array:
    there = np.isfinite(column)
    if there.sum() < 2:
        return np.full(len(grid), np.nan)
    stamps = time[there]
    result = PchipInterpolator(stamps, column[there], extrapolate=False)(grid)
    after = np.clip(np.searchsorted(stamps, grid), 1, len(stamps) - 1)
    distance = stamps[after] - stamps[after - 1]
    in_gap = (distance > _GAP * np.median(np.diff(stamps))) & ~np.isin(grid, stamps)
    return np.where(in_gap, np.nan, result)


def _continuous(quaternion: Array) -> Array:
    """q and -q are one orientation; of the two the one that is nearer to the sample before."""
    dots = np.nansum(quaternion[1:] * quaternion[:-1], axis=1)
    sign = np.concatenate([[1.0], np.cumprod(np.where(dots < 0, -1.0, 1.0))])
    return quaternion * sign[:, None]
