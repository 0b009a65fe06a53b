"""Single samples that leap out of a column and back: bit errors, lost packets, wrapped counters."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from experiments.measurement.checks.faults import Fault, counted, listed
from experiments.measurement.checks.matching import Array
from experiments.measurement.checks.time_faults import LEAST_ROWS, is_measured
from experiments.measurement.logs.log import Log, signal_names
from experiments.measurement.logs.noise_floor import MAD_TO_STD

_NOISE: Final = 100.0  # robust standard deviations of the usual bend at a sample; a knee at its stop makes 40
_BACK: Final = 0.3  # of the leap, by which the samples before and after may differ; a blow leaves more
# of the range that nearly all samples lie in: a torque may leap by twice that, a position by next to nothing
_OF_RANGE: Final = 3.0
_OF_TRAVEL: Final = 0.05


def spikes(log: Log) -> Iterator[Fault]:
    """One fault for each signal with spikes. An accelerometer may leap: it feels blows shorter than a sample."""
    for signal, table in log.signals.items():
        if not is_measured(signal) or signal == "base_acceleration":
            continue
        of_range = _OF_TRAVEL if signal.endswith("_position") else _OF_RANGE
        found = np.array([_leaps(column, of_range) for column in table.values.T])
        if found.any():
            names = tuple(name for name, leaps in zip(table.names, found, strict=True) if leaps.any())
            where = listed(names, signal_names(signal, log.joint))
            first = log.time[1 + np.argmax(found.any(0))]
            message = (
                f"{signal} of {where} leaps away and back within a sample in {counted(int(found.sum()), 'place')}, "
                f"first at {first:.6g} s; leave such cells empty or record the log again."
            )
            yield Fault("spike", where, message)


def _leaps(column: Array, of_range: float) -> Array:
    """Which inner samples (T - 2,) leap out between neighbours that agree."""
    there = np.isfinite(column)
    bend = np.abs(column[1:-1] - 0.5 * (column[2:] + column[:-2]))
    if there.sum() < LEAST_ROWS or not np.isfinite(bend).any():
        return np.zeros(len(bend), dtype=bool)
    low, high = np.percentile(column[there], [0.5, 99.5])
    usual = max(_NOISE * MAD_TO_STD * np.nanmedian(bend), of_range * (high - low))
    return (usual > 0) & (bend > usual) & (np.abs(column[2:] - column[:-2]) < _BACK * bend)
