"""One sensor under two names: columns that agree to the last digit, which no two noisy sensors do."""

from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from experiments.measurement.checks.faults import Fault, counted
from experiments.measurement.checks.links import Column
from experiments.measurement.checks.time_faults import is_measured
from experiments.measurement.logs.log import Log


def copied_columns(log: Log) -> Iterator[Fault]:
    """One fault for all columns that hold what another one holds."""
    if log.joint is not None and log.joint.drive in (None, "rigid"):
        return  # with no spring between them, motor and joint may share an encoder, command and effort a column
    pairs = [pair for same in _alike(log) for pair in pairwise(same) if not _move_as_one(log, *pair)]
    if pairs:
        (one, other), more = pairs[0], len(pairs) - 1
        what = f"{'/'.join(one)} and {'/'.join(other)}"
        if more:
            what += f" (and {counted(more, 'more such pair')})"
        where = " and ".join(dict.fromkeys(name for _, name in (one, other)))
        message = f"{what} hold the same values to the last digit in all rows; log each sensor under its own name."
        yield Fault("copied_column", where, message)


def _alike(log: Log) -> list[list[Column]]:
    """Groups of columns, one of them measured at least, that are equal in all rows and move."""
    found: dict[bytes, list[Column]] = defaultdict(list)
    for signal, table in log.signals.items():
        for name, values in zip(table.names, table.values.T, strict=True):
            if signal != "foot_contact" and np.nan_to_num(np.ptp(values)) > 0:
                found[(values + 0.0).tobytes()].append((signal, name))
    return [same for same in found.values() if len(same) > 1 and any(is_measured(signal) for signal, _ in same)]


def _move_as_one(log: Log, one: Column, other: Column) -> bool:
    """Whether the two joints agree in everything: a symmetric motion, simulated without noise."""
    if one[0] != other[0] or one[0] in log.noise_std:
        return False
    both = [(table.column(one[1]), table.column(other[1])) for s, table in log.signals.items() if is_measured(s)]
    return all(np.array_equal(a, b, equal_nan=True) for a, b in both if a is not None and b is not None)
