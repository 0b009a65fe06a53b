"""The least-squares problem of a refit: chi^2 of the replay, its normal equations, the logs' own nuisances."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from experiments.measurement.evidence.log_evidence import Evidence, Point
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fits.fit_variables import DIFFERENCE, Variable, added, difference, direction, first_value


class Own(NamedTuple):
    """A log's own nuisances near a point: where they want to be, and how they follow the variables."""

    best: np.ndarray  # change of their coefficients that fits best with the variables held
    follow: np.ndarray  # (nuisances, variables) further change per step of each variable


class Normal(NamedTuple):
    """Normal equations of the variables, the logs' own nuisances fitted away; half of chi^2."""

    hessian: np.ndarray
    gradient: np.ndarray
    without: tuple[tuple[np.ndarray, np.ndarray], ...]  # hessian and gradient, each block once left out
    own: tuple[Own, ...]


@dataclass(frozen=True, eq=False)
class Problem:
    """The least-squares problem: chi^2 of some blocks of some logs over the variables and the logs' nuisances."""

    logs: tuple[Evidence, ...]
    bases: tuple[np.ndarray, ...]  # x of each log, which the variables add to
    variables: list[Variable]
    masks: tuple[np.ndarray, ...]

    @property
    def scale(self) -> np.ndarray:
        return np.array([x.scale for x in self.variables])

    @property
    def prior(self) -> np.ndarray:
        return np.array([x.prior for x in self.variables])

    def start(self, effects: Sequence[Placed], nominal: Sequence[Nominal], start: Refitted | None) -> np.ndarray:
        fitted = [first_value(effects, x) for x in self.variables[: len(self.variables) - len(nominal)]]
        numbers = start.nominal if start and len(nominal) else [0.0] * len(nominal)
        return self.moved(np.array([*fitted, *numbers]), 0.0)

    def points(self, v: np.ndarray, nuisances: Sequence[Point]) -> list[Point]:
        """Points with these variables and the nuisances of others."""
        return [Point(self.x(i, v), p.shift, p.offset) for i, p in enumerate(nuisances)]

    def x(self, index: int, v: np.ndarray) -> np.ndarray:
        log, x = self.logs[index], self.bases[index]
        for variable, value in zip(self.variables, v, strict=True):
            x = added(log.atoms, x, variable, value)
        return x

    def cost(self, candidates: Sequence[np.ndarray], points: Sequence[Sequence[Point]]) -> np.ndarray:
        """chi^2 of the blocks with all priors, for each candidate."""
        found = np.array([((c / self.prior) ** 2).sum() for c in candidates])
        for i, log in enumerate(self.logs):
            mine = [p[i] for p in points]
            found += (log.chi2(mine) * self.masks[i]).sum(1) + [(log.coefficients(p) ** 2).sum() for p in mine]
        return found

    def above_noise(self, cost: float) -> float:
        """What a cost is more than noise alone would leave."""
        return cost - sum(float(log.weight()[mask].sum()) for log, mask in zip(self.logs, self.masks, strict=True))

    def normal(self, v: np.ndarray, points: Sequence[Point]) -> Normal:
        unit = self.unit(v)
        hessian, gradient = np.diag(1.0 / self.prior**2), v / self.prior**2
        changes, own = [], []
        for log, at, mask_ in zip(self.logs, points, self.masks, strict=True):
            steps = [difference(log.atoms, x, value) for x, value in zip(self.variables, v, strict=True)]
            gram = log.local(at, np.stack(steps) if steps else np.zeros((0, log.atoms.size)))[mask_]
            total, now = gram.sum(0), log.coefficients(at)
            h, g, mine = _reduced(total, now, unit)
            for block in gram:
                h_without, g_without, _ = _reduced(total - block, now, unit)
                changes.append((h_without - h, g_without - g))
            hessian, gradient = hessian + h, gradient + g
            own.append(mine)
        without = tuple((hessian + dh, gradient + dg) for dh, dg in changes)
        return Normal(hessian, gradient, without, tuple(own))

    def unit(self, v: np.ndarray) -> np.ndarray:
        """The difference quotients' steps."""
        return DIFFERENCE * self.scale * np.array([direction(x, a) for x, a in zip(self.variables, v, strict=True)])

    def step(self, v: np.ndarray, normal: Normal, damping: float) -> np.ndarray:
        relative = normal.hessian * np.outer(self.scale, self.scale)
        damped = relative + damping * np.diag(np.diag(relative)) + 1e-12 * np.eye(len(v))
        return -self.scale * np.linalg.solve(damped, self.scale * normal.gradient)

    def moved(self, v: np.ndarray, step: np.ndarray | float) -> np.ndarray:
        return np.clip(v + step, [x.low for x in self.variables], [x.high for x in self.variables])

    def follow(self, new: np.ndarray, v: np.ndarray, points: Sequence[Point], normal: Normal) -> list[Point]:
        """Points at new variables, with the nuisances where they then fit best."""
        found = []
        for i, (log, point, own) in enumerate(zip(self.logs, points, normal.own, strict=True)):
            shift, offset = log.nuisances(own.best + own.follow @ (new - v))
            found.append(Point(self.x(i, new), point.shift + shift, point.offset + offset))
        return found


def _reduced(gram: np.ndarray, now: np.ndarray, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray, Own]:
    """Hessian and gradient of a log's variables, its nuisances (that stand at `now`) where they fit best."""
    count = len(unit)
    inner = gram[count:-1, count:-1] + np.eye(len(now))  # a prior holds them near zero, not near where they are
    away = np.linalg.solve(inner, gram[count:-1, :count])
    z = -np.linalg.solve(inner, gram[count:-1, -1] + now)
    hessian = (gram[:count, :count] - gram[:count, count:-1] @ away) / np.outer(unit, unit)
    return hessian, (gram[:count, -1] + gram[:count, count:-1] @ z) / unit, Own(z, -away / unit)
