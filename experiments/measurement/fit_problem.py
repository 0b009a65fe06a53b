"""The least-squares problem of a refit: chi^2 of the replay, its normal equations, the logs' own nuisances."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from experiments.measurement.evidence import Evidence, Point
from experiments.measurement.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fit_variables import DIFFERENCE, Variable, added, difference, direction, first_value


class Own(NamedTuple):
    """A log's own nuisances near a point: where they want to be, and how they follow the variables."""

    best: np.ndarray  # change of their coefficients that fits best with the variables held
    follow: np.ndarray  # (nuisances, variables) further change per step of each variable


class Normal(NamedTuple):
    """Normal equations of the variables, the logs' own nuisances fitted away; half of chi^2."""

    hessian: np.ndarray
    gradient: np.ndarray
    gradients: tuple[np.ndarray, ...]  # per log (blocks, variables)
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

    def normal(self, v: np.ndarray, points: Sequence[Point]) -> Normal:
        unit, count = self.unit(v), len(v)
        hessian, gradients, own = np.diag(1.0 / self.prior**2), [], []
        for log, at, mask_ in zip(self.logs, points, self.masks, strict=True):
            steps = [difference(log.atoms, x, value) for x, value in zip(self.variables, v, strict=True)]
            gram = log.local(at, np.stack(steps) if steps else np.zeros((0, log.atoms.size)))
            gram = gram * mask_[:, None, None]
            total = gram.sum(0)
            now = log.coefficients(at)  # the prior holds them near zero, not near where they are
            inner = total[count:-1, count:-1] + np.eye(len(now))
            away = np.linalg.solve(inner, total[count:-1, :count])
            z = -np.linalg.solve(inner, total[count:-1, -1] + now)
            hessian = hessian + (total[:count, :count] - total[:count, count:-1] @ away) / np.outer(unit, unit)
            gradients.append((gram[:, :count, -1] + gram[:, :count, count:-1] @ z) / unit)
            own.append(Own(z, -away / unit))
        gradient = sum(g.sum(0) for g in gradients) + v / self.prior**2
        return Normal(hessian, gradient, tuple(gradients), tuple(own))

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
