"""Whether the noise that the log's JSON tells of its sensors can be true of what they logged."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from experiments.measurement.checks.faults import Fault
from experiments.measurement.checks.matching import Array
from experiments.measurement.logs.log import Log, si_unit
from experiments.measurement.logs.noise_floor import estimated

_TOO_MUCH: Final = 20.0  # times what single samples show; a filter in the sensor hides some
_TOO_LITTLE: Final = 0.1  # of the resolution, whose rounding alone leaves 0.29
_ROUNDING: Final = 1e-5  # of a column's range: values so close are one, in single precision


def noise_claims(log: Log) -> Iterator[Fault]:
    """A noise_std far above the scatter of the samples would explain everything, one below the rounding nothing.

    Of a rigid drive's log the smaller of the two is taken anyway: many drives filter what they log.
    """
    taken_as_told = "applied_torque" not in log.signals
    for signal, claimed in log.noise_std.items():
        if signal not in log.signals or claimed <= 0:
            continue
        values = log.signals[signal].values
        resolution = _resolution(values)
        scatter = max(estimated(values), resolution)
        unit = si_unit(signal, log.joint)
        if taken_as_told and scatter > 0 and claimed > _TOO_MUCH * scatter:
            shown = f"its samples scatter by {scatter:.2g} {unit}"
        elif claimed < _TOO_LITTLE * resolution:
            shown = f"it is logged in steps of {resolution:.2g} {unit}"
        else:
            continue
        message = f"noise_std of {signal} is {claimed:.2g} {unit} in the log's JSON, but {shown}; correct it there."
        yield Fault("noise_std", signal, message)


def _resolution(values: Array) -> float:
    """The smallest step of a column, the median over columns (T, n) that have any; 0 for none.

    From row to row or between values, whichever is less: a motor that chatters takes a large step in every row.
    """
    smallest = []
    for column in values.T:
        known = column[np.isfinite(column)]
        row_to_row, apart = np.abs(np.diff(known)), np.diff(np.unique(known))
        steps = np.concatenate([row_to_row[row_to_row > 0], apart[apart > _ROUNDING * apart.sum()]])
        smallest += [float(steps.min())] if len(steps) else []
    return float(np.median(smallest)) if smallest else 0.0
