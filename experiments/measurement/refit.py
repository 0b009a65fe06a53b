"""Refit: the chosen effects, together with the robot's nominal numbers, in the full non-linear replay.

Gauss-Newton with a trust region on the effects' parameters within their bounds. Fitted beside them, each with a
prior: what the robot's nominal numbers may be off by, the first motor angle, and constant errors of the channels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from experiments.measurement.evidence import Evidence, Point

ITERATIONS = 8
ENOUGH = 1e-4  # relative fall of chi^2 below which the fit has ended
STEP_LENGTHS = (1.0, 0.4, 0.1)
DIFFERENCE = 0.01  # of a parameter's start: the step of the difference quotients


class Placed(NamedTuple):
    """An effect at a place with its parameters."""

    effect: str
    where: str
    parameters: Mapping[str, float]

    def values(self) -> Mapping[str, float]:
        return self.parameters


class Nominal(NamedTuple):
    """A nominal number of the robot that may be a little off: an effect's strength, and its prior's deviation."""

    effect: str
    where: str
    parameter: str
    deviation: float


@dataclass(frozen=True)
class Refitted:
    """A fit. chi2, one array of blocks per log; covariance of the effects' parameters, in their order."""

    effects: tuple[Placed, ...]
    nominal: np.ndarray  # fitted deviations, in each one's own unit
    points: tuple[Point, ...]
    chi2: tuple[np.ndarray, ...]
    covariance: np.ndarray

    @property
    def total(self) -> float:
        return float(sum(c.sum() for c in self.chi2))


class _Variable(NamedTuple):
    effect: str
    where: str
    parameter: str
    low: float
    high: float
    scale: float
    prior: float  # standard deviation, inf without one


def refit(
    logs: Sequence[Evidence],
    effects: Sequence[Placed],
    nominal: Sequence[Nominal],
    start: Refitted | None = None,
    blocks: Sequence[np.ndarray] | None = None,
    iterations: int = ITERATIONS,
) -> Refitted:
    """Fit effects (from their values) and nominal numbers to the given blocks (masks per log; default: all)."""
    atoms = logs[0].atoms
    variables = _variables(logs[0], effects, nominal)
    v = np.array([_first(effects, x) for x in variables[: len(variables) - len(nominal)]] + [0.0] * len(nominal))
    if start is not None:
        v[len(v) - len(nominal) :] = start.nominal
    masks = blocks or [np.ones(log.blocks, bool) for log in logs]
    shifts = [p.shift for p in start.points] if start else [log.start().shift for log in logs]
    offsets = [p.offset for p in start.points] if start else [log.start().offset for log in logs]

    def point(values, i):
        x = logs[i].start().x
        for variable, value in zip(variables, values, strict=True):
            x = _add(atoms, x, variable, value)
        return Point(x, shifts[i], offsets[i])

    def cost(candidates):
        prior = [((c / _priors(variables)) ** 2).sum() for c in candidates]
        found = np.array(prior)
        for i, log in enumerate(logs):
            found += (log.chi2([point(c, i) for c in candidates]) * masks[i]).sum(1)
        return found

    scale = np.array([x.scale for x in variables])
    damping, best = 1e-6, cost([v])[0]
    hessian, gradients = np.eye(len(v)), []
    for _ in range(iterations):
        hessian, gradients, nuisances = _normal(logs, [point(v, i) for i in range(len(logs))], variables, v, masks)
        gradient = sum(g.sum(0) for g in gradients) + v / _priors(variables) ** 2
        for i, (s, o) in enumerate(nuisances):
            shifts[i], offsets[i] = shifts[i] + s, offsets[i] + o
        relative = hessian * np.outer(scale, scale)
        step = -scale * np.linalg.solve(
            relative + damping * np.diag(np.diag(relative)) + 1e-12 * np.eye(len(v)), scale * gradient
        )
        tried = [_clipped(v + length * step, variables) for length in STEP_LENGTHS]
        costs = cost([*tried, v])
        i = int(np.argmin(costs))
        fallen = best - costs[i]
        v = v if i == len(tried) else tried[i]
        damping = damping * 10 if i >= 2 else damping / 3
        best, previous = costs[i], best
        if fallen < ENOUGH * max(previous, 1.0) and i != len(tried):
            break
    points = tuple(point(v, i) for i in range(len(logs)))
    if effects:
        hessian, gradients, _ = _normal(logs, list(points), variables, v, masks)
    chi2 = tuple(log.chi2([p])[0] for log, p in zip(logs, points, strict=True))
    covariance = _covariance(hessian, gradients) if len(v) else np.zeros((0, 0))
    return _result(effects, variables, nominal, v, covariance, points, chi2)


def _normal(logs, points, variables, v, masks):
    """Hessian, gradient of each log's blocks (blocks, p), and each log's best shifts and offsets; chi^2 halved."""
    count = len(v)
    unit = DIFFERENCE * np.array([x.scale * _sign(x, value) for x, value in zip(variables, v, strict=True)])
    hessian, gradients, own = np.diag(1.0 / _priors(variables) ** 2), [], []
    for log, at, mask_ in zip(logs, points, masks, strict=True):
        steps = [_step(log.atoms, x, value) for x, value in zip(variables, v, strict=True)]
        gram = log.local(at, np.stack(steps) if steps else np.zeros((0, log.atoms.size))) * mask_[:, None, None]
        total = gram.sum(0)
        inner = total[count:-1, count:-1] + np.eye(len(total) - count - 1)
        now = log.coefficients(at)  # the prior holds them near zero, not near where they are
        # the blocks' gradients with the log's own nuisances fitted away, as they are in the whole
        away = np.linalg.solve(inner, total[count:-1, :count])
        z = -np.linalg.solve(inner, total[count:-1, -1] + now)
        hessian = hessian + (total[:count, :count] - total[:count, count:-1] @ away) / np.outer(unit, unit)
        slope = gram[:, :count, -1] + gram[:, :count, count:-1] @ z
        pull = (now + z)[None] / max(int(mask_.sum()), 1) * mask_[:, None]
        slope -= (gram[:, count:-1, -1] + gram[:, count:-1, count:-1] @ z + pull) @ away
        gradients.append(slope / unit)
        own.append(log.nuisances(z))
    return hessian, gradients, own


def _covariance(hessian: np.ndarray, gradients: Sequence[np.ndarray]) -> np.ndarray:
    """Covariance that holds under coloured residuals: the scatter of the blocks' gradients (a sandwich), where it is
    larger than what white noise would give."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    inverse = np.linalg.pinv(hessian * np.outer(scale, scale)) * np.outer(scale, scale)
    blocks = np.concatenate(gradients) if gradients else np.zeros((0, len(hessian)))
    count = max(int((np.abs(blocks).sum(1) > 0).sum()), 1)
    scatter = blocks.T @ blocks * count / max(count - len(hessian), 1)
    sandwich = inverse @ scatter @ inverse
    wider = np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(inverse), 1e-300), 1.0))
    return inverse * np.outer(wider, wider)


def _variables(log: Evidence, effects: Sequence[Placed], nominal: Sequence[Nominal]) -> list[_Variable]:
    known = {effect.name: effect for effect in log.atoms.effects}
    found = [
        _Variable(p.effect, p.where, q.name, q.low, q.high, abs(q.start) or abs(q.high), np.inf)
        for p in effects
        for q in known[p.effect].parameters
    ]
    for n in nominal:
        parameter = next(q for q in known[n.effect].parameters if q.name == n.parameter)
        found.append(_Variable(n.effect, n.where, n.parameter, parameter.low, parameter.high, n.deviation, n.deviation))
    return found


def _first(effects: Sequence[Placed], x: _Variable) -> float:
    placed = next(p for p in effects if (p.effect, p.where) == (x.effect, x.where))
    return float(np.clip(placed.parameters[x.parameter], x.low, x.high))


def _add(atoms, x: np.ndarray, variable: _Variable, value: float) -> np.ndarray:
    """Strengths at a place add up; a shape parameter is what the last one says."""
    here = atoms.selection(variable.effect, variable.where)
    k = [c.parameter.name for c in atoms.of(variable.effect)].index(variable.parameter)
    chosen = here[:, k] > 0
    x = x.copy()
    strength = atoms.of(variable.effect)[k].parameter.role == "strength"
    x[chosen] = x[chosen] + value if strength else value
    return x


def _sign(variable: _Variable, value: float) -> float:
    return -1.0 if value + DIFFERENCE * variable.scale > variable.high else 1.0


def _step(atoms, variable: _Variable, value: float) -> np.ndarray:
    """The difference quotient's step in x."""
    here = atoms.selection(variable.effect, variable.where)
    k = [c.parameter.name for c in atoms.of(variable.effect)].index(variable.parameter)
    return here[:, k] * DIFFERENCE * variable.scale * _sign(variable, value)


def _priors(variables: Sequence[_Variable]) -> np.ndarray:
    return np.array([x.prior for x in variables])


def _clipped(v: np.ndarray, variables: Sequence[_Variable]) -> np.ndarray:
    return np.clip(v, [x.low for x in variables], [x.high for x in variables])


def _result(effects, variables, nominal, v, covariance, points, chi2) -> Refitted:
    count = len(v) - len(nominal)
    values = iter(v[:count])
    fitted = []
    for placed in effects:
        names = [x.parameter for x in variables[:count] if (x.effect, x.where) == (placed.effect, placed.where)]
        fitted.append(Placed(placed.effect, placed.where, {name: float(next(values)) for name in names}))
    return Refitted(tuple(fitted), v[count:], points, chi2, covariance[:count, :count])
