"""Refit: the chosen effects, together with the robot's nominal numbers, in the full non-linear replay.

Gauss-Newton with a trust region on the effects' parameters within their bounds. Fitted beside them, each with a
prior: what the robot's nominal numbers may be off by, the first motor angle, and constant errors of the channels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from experiments.effects.effect import Effect
from experiments.effects.places import mask
from experiments.measurement.evidence import Evidence, Point

ITERATIONS = 8
ENOUGH = 2.0  # fall of chi^2 below which the fit has ended: a parameter is then within its interval
STEP_LENGTHS = (1.0, 0.4, 0.1)
STARTS = (1.0, 0.7, 0.4, 0.2)  # of the strength that a linear score gives an effect, which may overshoot
FARTHEST = 2.0  # deviations that a nominal number may be off by: beyond them it is an effect and has to prove itself
BLOWN_UP = 1e12  # chi^2 of a block whose replay is no number; finite, so that masks and sums keep their sense
PINNED = 1e-6  # of its deviation, that a number may be off by where an effect stands for it
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
    spread: np.ndarray  # their standard deviations; as the last fit with them free had them
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
    masks = tuple(blocks or [np.ones(log.blocks, bool) for log in logs])
    bases = tuple(log.start().x for log in logs)
    problem = _Problem(tuple(logs), bases, _variables(logs[0], effects, nominal), masks)
    return _solve(problem, effects, nominal, start, iterations)


def refit_effects(
    logs: Sequence[Evidence],
    effects: Sequence[Placed],
    nominal: Sequence[Nominal],
    held: Refitted,
    blocks: Sequence[np.ndarray],
    iterations: int,
) -> Refitted:
    """The same with the nominal numbers held where another fit has them: several times cheaper.

    The last effect starts from its strength or less of it: a sharp effect that starts too strong finds no way back.
    """
    bases = []
    for log in logs:
        x = log.start().x
        for variable, value in zip(_variables(log, (), nominal), held.nominal, strict=True):
            x = _add(log.atoms, x, variable, value)
        bases.append(x)
    problem = _Problem(tuple(logs), tuple(bases), _variables(logs[0], effects, ()), tuple(blocks))
    starts = [[*effects[:-1], _weaker(logs[0], effects[-1], share)] for share in STARTS]
    tried = [problem.start(start, (), held) for start in starts]
    costs = problem.cost(tried, [problem.points(v, held.points) for v in tried])
    effects = starts[int(np.argmin(np.nan_to_num(costs, nan=np.inf)))]
    return replace(_solve(problem, effects, (), held, iterations), nominal=held.nominal, spread=held.spread)


def _weaker(log: Evidence, placed: Placed, share: float) -> Placed:
    """An effect with a share of its strengths and its own shape."""
    effect = next(e for e in log.atoms.effects if e.name == placed.effect)
    strengths = {p.name: share * placed.parameters[p.name] for p in effect.strengths}
    return placed._replace(parameters={**placed.parameters, **strengths})


def settle(log: Evidence, taught: Refitted, nominal: Sequence[Nominal]) -> Refitted:
    """A log under the effects and nominal numbers that others taught: only its own nuisances are fitted."""
    x, variables = log.start().x, _variables(log, taught.effects, nominal)
    fitted = [_first(taught.effects, variable) for variable in variables[: len(variables) - len(nominal)]]
    for variable, value in zip(variables, [*fitted, *taught.nominal], strict=True):
        x = _add(log.atoms, x, variable, value)
    problem = _Problem((log,), (x,), [], (np.ones(log.blocks, bool),))
    settled = _solve(problem, (), (), None, ITERATIONS)
    return replace(settled, effects=taught.effects, nominal=taught.nominal, spread=taught.spread)


def _solve(
    problem: "_Problem",
    effects: Sequence[Placed],
    nominal: Sequence[Nominal],
    start: Refitted | None,
    iterations: int,
) -> Refitted:
    logs = problem.logs
    v = problem.start(effects, nominal, start)
    points = problem.points(v, start.points if start else [log.start() for log in logs])
    damping, best = 1e-6, problem.cost([v], [points])[0]
    for _ in range(iterations):
        normal = problem.normal(v, points)
        if not np.isfinite(normal.hessian).all():
            return _blown_up(problem, effects, nominal, v, points)
        tried = [problem.moved(v, length * problem.step(v, normal, damping)) for length in STEP_LENGTHS]
        tried.append(v)  # only the log's own nuisances move
        found = [problem.follow(c, v, points, normal) for c in tried]
        costs = np.nan_to_num(problem.cost(tried, found), nan=np.inf)  # a step too far may blow the replay up
        i = int(np.argmin(costs))
        fallen, best = best - costs[i], costs[i]
        v, points = tried[i], found[i]
        damping = damping * 10 if i >= 2 else damping / 3
        if fallen < ENOUGH and i < len(STEP_LENGTHS):
            break
    covariance = np.zeros((0, 0))
    if len(v):
        normal = problem.normal(v, points)
        if not np.isfinite(normal.hessian).all():
            return _blown_up(problem, effects, nominal, v, points)
        covariance = _covariance(normal.hessian, normal.gradients)
    chi2 = tuple(log.chi2([p])[0] for log, p in zip(logs, points, strict=True))
    return _result(effects, problem.variables, nominal, v, covariance, tuple(points), chi2)


def _blown_up(problem: "_Problem", effects, nominal, v: np.ndarray, points: Sequence[Point]) -> Refitted:
    """A fit whose replay, there or a small step away, is no number: it explains nothing and is never chosen."""
    chi2 = tuple(np.full(log.blocks, BLOWN_UP) for log in problem.logs)
    return _result(effects, problem.variables, nominal, v, np.zeros((len(v), len(v))), tuple(points), chi2)


class _Own(NamedTuple):
    """A log's own nuisances near a point: where they want to be, and how they follow the variables."""

    best: np.ndarray  # change of their coefficients that fits best with the variables held
    follow: np.ndarray  # (nuisances, variables) further change per step of each variable


class _Normal(NamedTuple):
    """Normal equations of the variables, the logs' own nuisances fitted away; half of chi^2."""

    hessian: np.ndarray
    gradient: np.ndarray
    gradients: tuple[np.ndarray, ...]  # per log (blocks, variables)
    own: tuple[_Own, ...]


@dataclass(frozen=True, eq=False)
class _Problem:
    """The least-squares problem: chi^2 of some blocks of some logs over the variables and the logs' nuisances."""

    logs: tuple[Evidence, ...]
    bases: tuple[np.ndarray, ...]  # x of each log, which the variables add to
    variables: list[_Variable]
    masks: tuple[np.ndarray, ...]

    @property
    def scale(self) -> np.ndarray:
        return np.array([x.scale for x in self.variables])

    @property
    def prior(self) -> np.ndarray:
        return np.array([x.prior for x in self.variables])

    def start(self, effects: Sequence[Placed], nominal: Sequence[Nominal], start: Refitted | None) -> np.ndarray:
        fitted = [_first(effects, x) for x in self.variables[: len(self.variables) - len(nominal)]]
        numbers = start.nominal if start and len(nominal) else [0.0] * len(nominal)
        return self.moved(np.array([*fitted, *numbers]), 0.0)

    def points(self, v: np.ndarray, nuisances: Sequence[Point]) -> list[Point]:
        """Points with these variables and the nuisances of others."""
        return [Point(self.x(i, v), p.shift, p.offset) for i, p in enumerate(nuisances)]

    def x(self, index: int, v: np.ndarray) -> np.ndarray:
        log, x = self.logs[index], self.bases[index]
        for variable, value in zip(self.variables, v, strict=True):
            x = _add(log.atoms, x, variable, value)
        return x

    def cost(self, candidates: Sequence[np.ndarray], points: Sequence[Sequence[Point]]) -> np.ndarray:
        """chi^2 of the blocks with all priors, for each candidate."""
        found = np.array([((c / self.prior) ** 2).sum() for c in candidates])
        for i, log in enumerate(self.logs):
            mine = [p[i] for p in points]
            found += (log.chi2(mine) * self.masks[i]).sum(1) + [(log.coefficients(p) ** 2).sum() for p in mine]
        return found

    def normal(self, v: np.ndarray, points: Sequence[Point]) -> _Normal:
        unit, count = self.unit(v), len(v)
        hessian, gradients, own = np.diag(1.0 / self.prior**2), [], []
        for log, at, mask_ in zip(self.logs, points, self.masks, strict=True):
            steps = [_step(log.atoms, x, value) for x, value in zip(self.variables, v, strict=True)]
            gram = log.local(at, np.stack(steps) if steps else np.zeros((0, log.atoms.size)))
            gram = gram * mask_[:, None, None]
            total = gram.sum(0)
            now = log.coefficients(at)  # the prior holds them near zero, not near where they are
            inner = total[count:-1, count:-1] + np.eye(len(now))
            away = np.linalg.solve(inner, total[count:-1, :count])
            z = -np.linalg.solve(inner, total[count:-1, -1] + now)
            hessian = hessian + (total[:count, :count] - total[:count, count:-1] @ away) / np.outer(unit, unit)
            gradients.append((gram[:, :count, -1] + gram[:, :count, count:-1] @ z) / unit)
            own.append(_Own(z, -away / unit))
        gradient = sum(g.sum(0) for g in gradients) + v / self.prior**2
        return _Normal(hessian, gradient, tuple(gradients), tuple(own))

    def unit(self, v: np.ndarray) -> np.ndarray:
        """The difference quotients' steps."""
        return DIFFERENCE * self.scale * np.array([_sign(x, a) for x, a in zip(self.variables, v, strict=True)])

    def step(self, v: np.ndarray, normal: _Normal, damping: float) -> np.ndarray:
        relative = normal.hessian * np.outer(self.scale, self.scale)
        damped = relative + damping * np.diag(np.diag(relative)) + 1e-12 * np.eye(len(v))
        return -self.scale * np.linalg.solve(damped, self.scale * normal.gradient)

    def moved(self, v: np.ndarray, step: np.ndarray | float) -> np.ndarray:
        return np.clip(v + step, [x.low for x in self.variables], [x.high for x in self.variables])

    def follow(self, new: np.ndarray, v: np.ndarray, points: Sequence[Point], normal: _Normal) -> list[Point]:
        """Points at new variables, with the nuisances where they then fit best."""
        found = []
        for i, (log, point, own) in enumerate(zip(self.logs, points, normal.own, strict=True)):
            shift, offset = log.nuisances(own.best + own.follow @ (new - v))
            found.append(Point(self.x(i, new), point.shift + shift, point.offset + offset))
        return found


def _covariance(hessian: np.ndarray, gradients: Sequence[np.ndarray]) -> np.ndarray:
    """Covariance that holds under coloured residuals: the scatter of the blocks' gradients (a sandwich), where it is
    larger than what white noise would give."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    inverse = np.linalg.pinv(hessian * np.outer(scale, scale)) * np.outer(scale, scale)
    blocks = np.concatenate(gradients) if gradients else np.zeros((0, len(hessian)))
    count = max(int((np.abs(blocks).sum(1) > 0).sum()), 1)
    scatter = blocks.T @ blocks * count / max(count - len(hessian), 1)
    sandwich = inverse @ scatter @ inverse
    white = np.diag(inverse)
    ratio = np.divide(np.diag(sandwich), white, out=np.ones(len(white)), where=white > np.finfo(float).tiny * 1e9)
    wider = np.sqrt(np.maximum(ratio, 1.0))
    return inverse * np.outer(wider, wider)


def _variables(log: Evidence, effects: Sequence[Placed], nominal: Sequence[Nominal]) -> list[_Variable]:
    known = {effect.name: effect for effect in log.atoms.effects}
    found = [
        _Variable(p.effect, p.where, q.name, q.low, q.high, abs(q.start) or abs(q.high), np.inf)
        for p in effects
        for q in known[p.effect].parameters
    ]
    for n, low, high in zip(nominal, *reach(log.atoms.effects, nominal), strict=True):
        prior = n.deviation
        if any(_takes_over(known[p.effect], p, n, log.atoms.joint_names) for p in effects):
            low, high, prior = 0.0, 0.0, PINNED * n.deviation
        found.append(_Variable(n.effect, n.where, n.parameter, low, high, n.deviation, prior))
    return found


def _takes_over(effect: Effect, placed: Placed, n: Nominal, joint_names: tuple[str, ...]) -> bool:
    """Whether an effect changes a nominal number wherever that counts: free beside it, neither would be determined."""
    if effect.name != n.effect or n.parameter not in placed.parameters:
        return False
    return bool((mask(placed.where, effect.axis, joint_names) >= mask(n.where, effect.axis, joint_names)).all())


def reach(effects: Sequence[Effect], nominal: Sequence[Nominal]) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest value of each nominal number, in its own unit: FARTHEST, or its parameter's own bound."""
    known = {(effect.name, p.name): p for effect in effects for p in effect.parameters}
    bounds = [known[n.effect, n.parameter] for n in nominal]
    low = [max(p.low, -FARTHEST * n.deviation) for p, n in zip(bounds, nominal, strict=True)]
    high = [min(p.high, FARTHEST * n.deviation) for p, n in zip(bounds, nominal, strict=True)]
    return np.array(low), np.array(high)


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


def _result(effects, variables, nominal, v, covariance, points, chi2) -> Refitted:
    count = len(v) - len(nominal)
    values = iter(v[:count])
    fitted = []
    for placed in effects:
        names = [x.parameter for x in variables[:count] if (x.effect, x.where) == (placed.effect, placed.where)]
        fitted.append(Placed(placed.effect, placed.where, {name: float(next(values)) for name in names}))
    spread = np.sqrt(np.maximum(np.diag(covariance)[count:], 0.0))
    return Refitted(tuple(fitted), v[count:], spread, points, chi2, covariance[:count, :count])
