"""Where a fit of sharp effects begins if a few rows far off would pull it away: least absolute residuals.

Of a supply that collapses, chi^2 has a valley every few per cent of its resistance, as the same few rows fall to one
side or the other; the sum of absolute residuals has one.
"""

from collections.abc import Sequence

import numpy as np

from experiments.measurement.evidence.log_evidence import Evidence, Point
from experiments.measurement.fits.fit_problem import Problem
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fits.fit_variables import variables_of
from experiments.measurement.fits.refit import weaker

MULTIPLES = np.geomspace(0.4, 2.5, 32)  # of an effect's strengths: 6 % apart


def from_afar(logs: Sequence[Evidence], fit: Refitted, nominal: Sequence[Nominal]) -> list[Placed]:
    """A fit's effects, the strengths of each sharp one in turn at the multiple that leaves least absolute residuals."""
    effects = list(fit.effects)
    known = {effect.name: effect for effect in logs[0].atoms.effects}
    bases = tuple(log.start().x for log in logs)
    masks = tuple(np.ones(log.blocks, bool) for log in logs)
    problem = Problem(tuple(logs), bases, variables_of(logs[0], effects, nominal), masks)
    for k in (k for k, placed in enumerate(effects) if known[placed.effect].sharp):
        others = [effects[k], *(weaker(logs[0], effects[k], size) for size in MULTIPLES)]
        tried = [[*effects[:k], other, *effects[k + 1 :]] for other in others]
        starts = [problem.start(one, nominal, fit) for one in tried]
        points = [problem.points(v, fit.points) for v in starts]
        problem.cost(starts, points)  # all replays at once
        left = np.array([sum(map(_absolute, logs, p)) for p in points])
        effects = tried[int(np.argmin(np.nan_to_num(left, nan=np.inf)))]
    return effects


def _absolute(log: Evidence, point: Point) -> float:
    """Sum of absolute residuals, rows thinned to independent ones."""
    return sum(float((np.abs(rest.residual) / np.sqrt(rest.part.tau)).sum()) for rest in log.rests(point))
