"""Which rows a log is judged on: those aside that, by the best of what was tried, next to nothing decides.

A few such rows of hundreds of noises outweigh all that an effect explains.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d

from experiments.measurement.evidence.log_evidence import Evidence, Point
from experiments.measurement.evidence.untold import REACH, without_untold
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fits.from_afar import from_afar
from experiments.measurement.fits.refit import refit
from experiments.measurement.selection.ladder import Selection

FEW = 0.02  # of a log's rows
MOST = 0.5  # of what a fit leaves above the noise, that so few rows hold


class Judged(NamedTuple):
    """Logs without rows that a fit's replays do not tell, and that fit's effects."""

    logs: tuple[Evidence, ...]
    effects: tuple[Placed, ...]


def judged_rows(logs: Sequence[Evidence], selection: Selection) -> Judged | None:
    """The logs without the rows that the best fit's replays do not tell; None where that leaves no less than half.

    The best fit is the one that leaves least outside of its worst rows: it need not have been chosen.
    Fitted again without those it may leave much less by itself, and is worth a selection that begins there.
    """
    if any(log.drive is None for log in logs):
        return None
    best = min(_fits(selection), key=lambda fit: _left(logs, fit)[0])
    outside, worst = _left(logs, best)
    if worst < MOST * (outside + worst):
        return None
    best = _fitted_outside(logs, best, selection.nominal)
    told = tuple(without_untold(log, point) for log, point in zip(logs, best.points, strict=True))
    return Judged(told, best.effects) if sum(_left(told, best)) < (1.0 - MOST) * (outside + worst) else None


def set_aside(logs: Sequence[Evidence], judged: Sequence[Evidence]) -> str:
    """In one sentence, how much of the logs is not judged; empty where all is."""
    whole, told = (sum(float(log.drive.used.sum()) for log in some if log.drive is not None) for some in (logs, judged))
    if told == whole:
        return ""
    share = f"{1.0 - told / whole:.1%} of what the drives tell"
    return f"{share} is not judged: next to nothing decides there how the motors switch."


def _fits(selection: Selection) -> Iterator[Refitted]:
    """Every fit that was tried."""
    yield selection.fit
    for finalists in selection.refitted:
        for finalist in finalists:
            yield finalist.fit


def _fitted_outside(logs: Sequence[Evidence], fit: Refitted, nominal: Sequence[Nominal]) -> Refitted:
    """A fit's effects and numbers fitted again without its worst rows, which pull them to where they matter least."""
    others = []
    for log, point in zip(logs, fit.points, strict=True):
        rows = _over(log, point)
        worst = np.zeros(len(rows), bool)
        worst[np.argsort(rows)[-_few(rows) :]] = True
        others.append(log.without(maximum_filter1d(worst, 2 * REACH + 1)[:, None, None]))
    return refit(others, from_afar(others, fit, nominal), nominal, fit)


def _few(rows: np.ndarray) -> int:
    return max(round(FEW * len(rows)), 1)


def _left(logs: Sequence[Evidence], fit: Refitted) -> tuple[float, float]:
    """What a fit leaves of the drives above the noise: outside of the FEW worst rows, and in them."""
    outside = worst = 0.0
    for log, point in zip(logs, fit.points, strict=True):
        rows = np.sort(_over(log, point))
        outside += max(rows[: -_few(rows)].sum(), 0.0) if np.isfinite(rows).all() else np.inf
        worst += rows[-_few(rows) :].sum()
    return outside, worst


def _over(log: Evidence, point: Point) -> np.ndarray:
    """chi^2 of the drives above the noise's, row by row (rows,)."""
    return (log.drive_residual([point])[0] ** 2 - log.drive.used).sum((1, 2))
