"""Is the law of a found effect the same all along? One that fades with time, or grows with speed, load or position
beyond its own law, is another law, which the effect at best imitates.

At the fit, each strength may change by a share of itself in proportion to a state m in [-1, 1]: that changes the
residual by m times the effect's own column. What such a change would take from chi^2, everything else fitted again, is
a score test for parameter constancy (Nyblom, JASA 84(405), 1989, DOI 10.1080/01621459.1989.10478759).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from experiments.effects.effect import Effect
from experiments.measurement.evidence.features import gain, projected
from experiments.measurement.evidence.log_evidence import Evidence, LocalPart
from experiments.measurement.evidence.states import States, states_of
from experiments.measurement.fits.fit_problem import Problem
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fits.fit_variables import Variable, difference, variables_of
from experiments.measurement.fits.misfit import above_floor

Array = np.ndarray

CLEAR = 200.0  # fall of chi^2: right effects of 88 logs of the second plant stay below 120, most below 10
OF_REST = 0.15  # of what the fit leaves above the floor, that a change takes: else it is the rest that has another law
LARGE = 0.05  # of the effect, at either end of the state: a smaller change may be the model's own error


class Change(NamedTuple):
    """An effect whose strength would have to change with a state: by a share of itself to each side of the mean."""

    effect: str
    where: str
    state: str
    share: float
    gain: float  # of chi^2

    def in_words(self) -> str:
        return f"{self.effect} at {self.where} would have to change by {self.share:.0%} with the {self.state}"


@dataclass(frozen=True)
class _Fitted:
    """A fit's variables, where they stand, the steps of their columns, and each log's columns and states."""

    variables: Sequence[Variable]
    values: Array
    units: Array
    logs: Sequence[tuple[Array, Sequence[tuple[LocalPart, States]]]]  # nuisances' coefficients, parts

    def of(self, placed: Placed, effect: Effect) -> list[int]:
        """The variables that are an effect's strengths."""
        names = {p.name for p in effect.strengths}
        here = enumerate(self.variables)
        return [i for i, x in here if (x.effect, x.where) == placed[:2] and x.prior == np.inf and x.parameter in names]


def changes_in(logs: Sequence[Evidence], fit: Refitted, nominal: Sequence[Nominal]) -> list[Change]:
    """Effects of a fit that are not steady, each with the state that tells most; the clearest first."""
    if not fit.effects:
        return []
    at, found = _fitted(logs, fit, nominal), []
    least = max(CLEAR, OF_REST * above_floor(logs, fit))
    known = {effect.name: effect for effect in logs[0].atoms.effects}
    for placed in fit.effects:
        effect = known[placed.effect]
        judged = [_judged(at, placed, effect, state) for state in _states_of(effect)]
        clear = [one for one in judged if one.gain > least and one.share > LARGE]
        found += [max(clear, key=lambda one: one.gain)] if clear else []
    return sorted(found, key=lambda one: -one.gain)


def _states_of(effect: Effect) -> tuple[str, ...]:
    """What an effect's strength must not change with: of one with a memory, an edge or a fine period, only time
    tells."""
    only_time = effect.memory or effect.sharp or effect.fine
    return ("time",) if only_time or effect.axis != "joint" else ("time", "position", "speed", "load")


def _fitted(logs: Sequence[Evidence], fit: Refitted, nominal: Sequence[Nominal]) -> _Fitted:
    variables = variables_of(logs[0], fit.effects, nominal)
    problem = Problem(tuple(logs), (), variables, ())
    effects = [value for placed in fit.effects for value in placed.parameters.values()]
    values = np.array([*effects, *fit.nominal])
    found = []
    for log, point in zip(logs, fit.points, strict=True):
        steps = [difference(log.atoms, x, value) for x, value in zip(variables, values, strict=True)]
        parts = zip(log.local_parts(point, np.stack(steps)), states_of(log, point), strict=True)
        found.append((log.coefficients(point), list(parts)))
    return _Fitted(variables, values, problem.unit(values), found)


def _judged(at: _Fitted, placed: Placed, effect: Effect, state: str) -> Change:
    """The score of a change of an effect's strengths with a state."""
    mine, k = at.of(placed, effect), len(at.variables)
    total = sum(_gram(own, parts, k, mine, state) for own, parts in at.logs)
    prior = np.array([x.prior for x in at.variables])
    rest = _without(_observed(total, at.units / prior, at.values / prior), k)
    s = len(mine)
    scored = gain(rest, np.eye(s + 1)[:, :s])
    whole = at.values[mine] / at.units[mine]
    most = float(whole @ rest[:s, :s] @ whole)  # what all of the effect would move if it went with the state
    share = np.sqrt(max(scored.gain, 0.0) / most) if most > 0 else 0.0
    return Change(placed.effect, placed.where, state, float(share), scored.gain)


def _gram(own: Array, parts: Sequence[tuple[LocalPart, States]], k: int, mine: Sequence[int], state: str) -> Array:
    """Gram matrix of the variables, an effect's columns times a state, and the residual, over one log whose nuisances
    stand at `own` and are fitted away."""
    n = len(own)
    total = np.zeros((n + k + len(mine) + 1,) * 2)
    for part, states in parts:
        columns = np.concatenate([part.columns[:-1], part.columns[mine] * states[state], part.columns[-1:]])
        columns = columns.reshape(len(columns), -1).astype(float)
        index = np.r_[(part.index[:-1] - k) % (n + k), n + k : len(total)]  # nuisances first
        total[np.ix_(index, index)] += columns @ columns.T
    return _without(_observed(total, np.ones(n), own), n)


def _observed(gram: Array, size: Array, now: Array) -> Array:
    """A gram matrix with priors of its first columns as further observations: their size, and what they see now."""
    n = np.arange(len(size))
    gram = gram.copy()
    gram[n, n] += size**2
    gram[n, -1] += size * now
    gram[-1, n] += size * now
    return gram


def _without(gram: Array, count: int) -> Array:
    """A gram matrix with its first `count` columns fitted away."""
    scale = np.sqrt(np.maximum(np.diag(gram)[:count], 1e-300))
    return projected(gram, list(np.eye(len(gram))[:count] / scale[:, None]), np.zeros(count))[count:, count:]
