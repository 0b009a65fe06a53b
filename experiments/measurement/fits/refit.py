"""Refit: the chosen effects, together with the robot's nominal numbers, in the full non-linear replay.

Damped Gauss-Newton (Levenberg and Marquardt) on the effects' parameters within their bounds. Fitted beside them, each
with a prior: what the robot's nominal numbers may be off by, the first motor angle, and constant errors of the
channels.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from experiments.measurement.evidence.log_evidence import Evidence, Point
from experiments.measurement.fits.fit_problem import Normal, Problem
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fits.fit_variables import added, first_value, variables_of

ITERATIONS = 8
SHORT_FIT = 4  # iterations that are enough near a fit
ENOUGH = 2.0  # fall of chi^2 below which the fit has ended: a parameter is then within its interval
NEARLY = 1e-4  # of what a fit leaves above the noise: where that is much, falls that decide nothing end it, too
LEAST_DAMPING, STIFFER = 1e-2, 100.0  # of a step after one that did not bring chi^2 down
STEP_LENGTHS = (1.0, 0.4, 0.1)
STARTS = (1.0, 0.7, 0.4, 0.2)  # of the strength that a linear score gives an effect, which may overshoot
PLAUSIBLE = (0.3, 0.6, 1.0, 1.5, 2.0, 3.0)  # of a parameter's start
BLOWN_UP = 1e12  # chi^2 of a block whose replay is no number; finite, so that masks and sums keep their sense


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
    problem = Problem(tuple(logs), bases, variables_of(logs[0], effects, nominal), masks)
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

    The last effect starts from its strength or less of it: a sharp effect that starts too strong finds no way back. Of
    a sharp one the linear score may say nothing at all: plausible strengths are tried, too.
    """
    bases = []
    for log in logs:
        x = log.start().x
        for variable, value in zip(variables_of(log, (), nominal), held.nominal, strict=True):
            x = added(log.atoms, x, variable, value)
        bases.append(x)
    problem = Problem(tuple(logs), tuple(bases), variables_of(logs[0], effects, ()), tuple(blocks))
    last = [weaker(logs[0], effects[-1], share) for share in STARTS] + _plausible(logs[0], effects[-1])
    starts = [[*effects[:-1], placed] for placed in last]
    tried = [problem.start(start, (), held) for start in starts]
    costs = problem.cost(tried, [problem.points(v, held.points) for v in tried])
    effects = starts[int(np.argmin(np.nan_to_num(costs, nan=np.inf)))]
    return replace(_solve(problem, effects, (), held, iterations), nominal=held.nominal, spread=held.spread)


def _plausible(log: Evidence, placed: Placed) -> list[Placed]:
    """A sharp effect with its own shape and all its strengths at a multiple of their start; none of another effect."""
    effect = next(e for e in log.atoms.effects if e.name == placed.effect)
    if not effect.sharp:
        return []
    strengths = [{p.name: np.clip(size * p.start, p.low, p.high) for p in effect.strengths} for size in PLAUSIBLE]
    return [placed._replace(parameters={**placed.parameters, **values}) for values in strengths]


def weaker(log: Evidence, placed: Placed, share: float) -> Placed:
    """An effect with a share of its strengths and its own shape."""
    effect = next(e for e in log.atoms.effects if e.name == placed.effect)
    strengths = {p.name: share * placed.parameters[p.name] for p in effect.strengths}
    return placed._replace(parameters={**placed.parameters, **strengths})


def settle(log: Evidence, taught: Refitted, nominal: Sequence[Nominal]) -> Refitted:
    """A log under the effects and nominal numbers that others taught: only its own nuisances are fitted."""
    x, variables = log.start().x, variables_of(log, taught.effects, nominal)
    fitted = [first_value(taught.effects, variable) for variable in variables[: len(variables) - len(nominal)]]
    for variable, value in zip(variables, [*fitted, *taught.nominal], strict=True):
        x = added(log.atoms, x, variable, value)
    problem = Problem((log,), (x,), [], (np.ones(log.blocks, bool),))
    settled = _solve(problem, (), (), None, ITERATIONS)
    return replace(settled, effects=taught.effects, nominal=taught.nominal, spread=taught.spread)


def _solve(
    problem: Problem,
    effects: Sequence[Placed],
    nominal: Sequence[Nominal],
    start: Refitted | None,
    iterations: int,
) -> Refitted:
    logs = problem.logs
    v = problem.start(effects, nominal, start)
    points = problem.points(v, start.points if start else [log.start() for log in logs])
    damping, best, normal = 1e-6, np.nan_to_num(problem.cost([v], [points])[0], nan=np.inf), None
    for _ in range(iterations):
        normal = problem.normal(v, points) if normal is None else normal
        if not np.isfinite(normal.hessian).all():
            break
        step = problem.step(v, normal, damping)
        tried = [problem.moved(v, length * step) for length in STEP_LENGTHS]
        tried.append(v)  # only the log's own nuisances move
        found = [problem.follow(c, v, points, normal) for c in tried]
        costs = np.nan_to_num(problem.cost(tried, found), nan=np.inf)  # a step too far may blow the replay up
        i = int(np.argmin(costs))
        if costs[i] >= best:
            if (v - tried[0]) @ normal.gradient < ENOUGH:  # what the step promised, within the bounds
                break
            damping = max(STIFFER * damping, LEAST_DAMPING)
            continue
        fallen, best = best - costs[i], costs[i]
        v, points = tried[i], found[i]
        damping = damping * 10 if i >= 2 else damping / 3
        if fallen < max(ENOUGH, NEARLY * problem.above_noise(best)) and i < len(STEP_LENGTHS):
            break  # its covariance is that of a step before: near enough, but rough where it ends with much left
        normal = None
    normal = problem.normal(v, points) if normal is None else normal
    if not np.isfinite(normal.hessian).all():
        return _blown_up(problem, effects, nominal, v, points)
    covariance = _covariance(normal) if len(v) else np.zeros((0, 0))
    chi2 = tuple(log.chi2([p])[0] + log.constant_errors(p).sum(1) for log, p in zip(logs, points, strict=True))
    return _result(effects, problem.variables, nominal, v, covariance, tuple(points), chi2)


def _blown_up(problem: Problem, effects, nominal, v: np.ndarray, points: Sequence[Point]) -> Refitted:
    """A fit whose replay is no number a small step away: it explains nothing and is never chosen."""
    chi2 = tuple(np.full(log.blocks, BLOWN_UP) for log in problem.logs)
    return _result(effects, problem.variables, nominal, v, np.zeros((len(v), len(v))), tuple(points), chi2)


def _covariance(normal: Normal) -> np.ndarray:
    """Covariance that holds under coloured residuals: what leaving out each block in turn moves (the jackknife), where
    that is more than white noise would.

    Priors hold what a few blocks cannot tell apart, here as in the fit: there may be more variables than blocks.
    Source: Efron and Stein, Annals of Statistics 9(3), 1981, DOI 10.1214/aos/1176345462.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal.hessian), 1e-300))
    inverse = np.linalg.pinv(normal.hessian * np.outer(scale, scale)) * np.outer(scale, scale)
    if len(normal.without) < 2:
        return inverse
    moved = [np.linalg.pinv(h * np.outer(scale, scale)) @ (scale * g) for h, g in normal.without]
    away = scale * (np.stack(moved) - np.mean(moved, 0))
    jackknife, white = (len(away) - 1) / len(away) * (away**2).sum(0), np.diag(inverse)
    ratio = np.divide(jackknife, white, out=np.ones(len(white)), where=white > np.finfo(float).tiny * 1e9)
    wider = np.sqrt(np.maximum(ratio, 1.0))
    return inverse * np.outer(wider, wider)


def _result(effects, variables, nominal, v, covariance, points, chi2) -> Refitted:
    count = len(v) - len(nominal)
    values = iter(v[:count])
    fitted = []
    for placed in effects:
        names = [x.parameter for x in variables[:count] if (x.effect, x.where) == (placed.effect, placed.where)]
        fitted.append(Placed(placed.effect, placed.where, {name: float(next(values)) for name in names}))
    spread = np.sqrt(np.maximum(np.diag(covariance)[count:], 0.0))
    return Refitted(tuple(fitted), v[count:], spread, points, chi2, covariance[:count, :count])
