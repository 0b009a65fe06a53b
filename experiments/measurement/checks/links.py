"""Columns of a log that must agree with one another, and how well they do.

A `Link` says which columns belong together and what one of them is made of by the others: a velocity is the rate
of a position, a torque the spring's deflection. Its gains and delay may stray as far as a physical effect may take
them; a swapped, flipped, rescaled or shifted column goes further, and the misfit tells.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from experiments.measurement.checks.matching import Array, Match, match
from experiments.measurement.logs.log import Log

Column = tuple[str, str]  # signal and name: ("joint_position", "LF_HAA")
Columns = Mapping[Column, Array]

GAIN: Final = (0.6, 1.6)  # what a worn spring or a badly calibrated sensor may do
LAG: Final = (-2.5, 2.5)  # samples; up to two are an effect, 'sensor_delay'
STILL: Final = (-1.0, 1.0)  # samples; where no sensor is late
_MOST_MISSING: Final = 0.1  # share of a column without value up to which it is bridged


@dataclass(frozen=True)
class Link:
    """A target column as a sum of terms with unknown gains and one unknown delay.

    `parts` makes (target, terms) of the columns, each (T,) or (T, m); `high` is the highest frequency looked at [Hz].
    No conclusion is drawn from misfits below `floor`, which noise and effects may leave.
    """

    name: str
    columns: tuple[Column, ...]
    parts: Callable[[Columns], tuple[Array, list[Array]]]
    high: float
    floor: float
    bounds: tuple[tuple[float, float], ...] = (GAIN,)
    lags: tuple[float, float] = LAG
    still: tuple[float, float] = STILL  # samples of delay where no sensor is late
    low: float = 0.0  # Hz, the lowest frequency looked at

    def match(self, columns: Columns, period: float) -> Match:
        """The best fit with gains and delay where effects may take them."""
        return self._match(columns, period, self.bounds, self.lags)

    def still_match(self, columns: Columns, period: float) -> Match:
        """The best fit with gains where effects may take them, but hardly any delay."""
        return self._match(columns, period, self.bounds, self.still)

    def free_match(self, columns: Columns, period: float, most_lag: float) -> Match:
        """The best fit with any gain of the first term, and up to `most_lag` samples of delay either way."""
        bounds = ((-math.inf, math.inf), *self.bounds[1:])
        return self._match(columns, period, bounds, (-most_lag, most_lag))

    def _match(
        self,
        columns: Columns,
        period: float,
        bounds: tuple[tuple[float, float], ...],
        lags: tuple[float, float],
    ) -> Match:
        target, terms = self.parts(columns)
        high = min(self.high * period, 0.4)
        return match(target, terms, list(bounds), lags, (self.low * period, high))


def usable_columns(log: Log) -> dict[Column, Array]:
    """Columns with (nearly) all their values, the gaps bridged by straight lines; constant ones are left out.

    Commands are kept with their gaps: an empty cell there says that the joint is in the other mode.
    """
    usable = {}
    for signal, table in log.signals.items():
        for place, name in enumerate(table.names):
            column = table.values[:, place]
            finite = np.isfinite(column)
            if signal.startswith("command"):
                if finite.any():
                    usable[signal, name] = column
            elif finite.mean() >= 1.0 - _MOST_MISSING and np.ptp(column[finite]) > 0:
                usable[signal, name] = np.interp(log.time, log.time[finite], column[finite])
    return usable
