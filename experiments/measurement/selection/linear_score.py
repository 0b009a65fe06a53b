"""The linear score: what every effect at every place promises, with the robot's nominal numbers projected out.

Score (phi' P r)^2 / (phi' P phi) with P = W - W G (G' W G + prior)^-1 G' W, over one or several logs.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from experiments.effects.effect import Effect
from experiments.effects.places import mask
from experiments.measurement.evidence.features import Change, Products, Variant, gain, projected
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Nominal, Refitted
from experiments.measurement.fits.fit_variables import reach, stands_for
from experiments.measurement.fits.nominal import at_end


class Scored(NamedTuple):
    """A linear hypothesis with its score."""

    effect: Effect
    where: str
    gain: float  # fall of chi^2, linear, all blocks
    values: dict[str, float]
    variant: Variant


def score(
    logs: Sequence[Evidence],
    fit: Refitted,
    nominal: Sequence[Nominal],
    changes: list[Change],
    variants: list[Variant],
) -> list[Scored]:
    """Every effect at its best place and shape, best first."""
    products = [log.products(point, changes) for log, point in zip(logs, fit.points, strict=True)]
    return scored_at(logs, products, fit, nominal, changes, variants)


def scored_at(
    logs: Sequence[Evidence],
    products: Sequence[Products],
    fit: Refitted,
    nominal: Sequence[Nominal],
    changes: Sequence[Change],
    variants: Sequence[Variant],
) -> list[Scored]:
    """The same from products (one for each log) that are known already."""
    atoms = logs[0].atoms
    ended = at_end(nominal, fit)
    follow = [n for n in nominal if n not in ended]
    reduced = [_without_nuisances(p, atoms, follow, changes) for p in products]
    found = []
    for variant in variants:
        for where in atoms.places(variant.effect):
            place = mask(where, variant.effect.axis, atoms.joint_names)
            directions = [p.direction(atoms, variant, changes, place) for p in products]
            scored = _joint_gain(reduced, directions)
            values = dict(changes[variant.changes[0]].shapes)
            values |= {changes[k].strength: float(v) for k, v in zip(variant.changes, scored.values, strict=True)}
            value_gain = scored.gain if _possible(variant.effect, values) else 0.0
            found.append(Scored(variant.effect, where, value_gain, _bounded(variant.effect, values), variant))
    return sorted(found, key=lambda s: -s.gain)


def best_of_each(ranking: Sequence[Scored]) -> list[Scored]:
    """The best place and shape of each effect."""
    seen, best = set(), []
    for scored in ranking:
        if scored.effect.name not in seen:
            seen.add(scored.effect.name)
            best.append(scored)
    return best


def following(
    logs: Sequence[Evidence],
    products: Sequence[Products],
    fit: Refitted,
    nominal: Sequence[Nominal],
    changes: Sequence[Change],
    scored: Scored,
) -> np.ndarray:
    """Where the nominal numbers want to be once a hypothesis has the value of its score (linear).

    A number that the hypothesis itself moves is nominal again: the effect takes over what it was off by.
    """
    if not nominal:
        return fit.nominal
    atoms, deviation = logs[0].atoms, np.array([n.deviation for n in nominal])
    now = fit.nominal / deviation
    hessian, gradient = np.eye(len(nominal)), now.copy()
    place = mask(scored.where, scored.effect.axis, atoms.joint_names)
    strengths = np.array([scored.values[changes[k].strength] for k in scored.variant.changes])
    for p in products:
        gram = projected(p.gram.sum(0), _own(p), np.ones(len(p.nuisances)))
        g = np.stack(_nominal_directions(p, atoms, nominal, changes), 1)
        moved = p.direction(atoms, scored.variant, changes, place) @ strengths
        moved[-1] += 1.0  # the residual itself
        hessian = hessian + g.T @ gram @ g
        gradient = gradient + g.T @ gram @ moved
    low, high = (bound / deviation for bound in reach(atoms.effects, nominal))
    wanted = (now + _bounded_step(hessian, gradient, low - now, high - now)) * deviation
    held = [stands_for(scored.effect, scored.where, scored.values, n, atoms.joint_names) for n in nominal]
    return np.where(held, 0.0, wanted)


def _bounded_step(hessian: np.ndarray, gradient: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The Newton step (k,) within bounds: what would leave them stays at them, and the others do without it."""
    step, free = np.zeros(len(gradient)), np.ones(len(gradient), bool)
    while free.any():
        rest = gradient[free] + hessian[np.ix_(free, ~free)] @ step[~free]
        step[free] = -np.linalg.solve(hessian[np.ix_(free, free)], rest)
        out = free & ((step < low) | (step > high))
        if not out.any():
            break
        step[out] = np.clip(step[out], low[out], high[out])
        free &= ~out
    return np.clip(step, low, high)


def _without_nuisances(p: Products, atoms, nominal, changes) -> np.ndarray:
    directions = [*_own(p), *_nominal_directions(p, atoms, nominal, changes)]
    return projected(p.gram.sum(0), directions, np.ones(len(directions)))


def _own(p: Products) -> list[np.ndarray]:
    """Directions of a log's own nuisances."""
    unit = np.eye(p.gram.shape[1])
    return [unit[i] for i in p.nuisances]


def _nominal_directions(p: Products, atoms, nominal, changes) -> list[np.ndarray]:
    """What each nominal number does when it is one deviation off."""
    directions = []
    for n in nominal:
        k = next(k for k, c in enumerate(changes) if (c.effect.name, c.strength) == (n.effect, n.parameter))
        column = np.zeros(p.gram.shape[1])
        place = mask(n.where, changes[k].effect.axis, atoms.joint_names)
        column[p.start[k] : p.start[k] + len(place)] = place / changes[k].step * n.deviation
        directions.append(column)
    return directions


def _joint_gain(reduced: list[np.ndarray], directions: list[np.ndarray]):
    """One hypothesis over several logs: its parameters are shared."""
    if len(reduced) == 1:
        return gain(reduced[0], directions[0])
    count = directions[0].shape[1]
    total = np.zeros((count + 1, count + 1))
    for w, d in zip(reduced, directions, strict=True):
        both = np.concatenate([d, np.eye(len(w))[:, -1:]], 1)
        total += both.T @ w @ both
    return gain(total, np.eye(count + 1)[:, :count])


def _possible(effect: Effect, values: dict[str, float]) -> bool:
    """Whether the strengths point into their bounds at all (a negative backlash does not)."""
    return all(p.low < 0 or values[p.name] > 0 for p in effect.strengths) if len(effect.strengths) == 1 else True


def _bounded(effect: Effect, values: dict[str, float]) -> dict[str, float]:
    return {p.name: float(np.clip(values.get(p.name, p.start), p.low, p.high)) for p in effect.parameters}
