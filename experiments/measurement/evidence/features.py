"""Features: what the residual would change by if an effect were there, for every effect at every place.

A change sets an effect's numbers everywhere it can act and asks each part of the evidence what its residuals do
(a secant: sharp effects such as backlash have no useful derivative at zero). The products of all these columns, of
the nuisances and of the residual itself, summed over each block of the log, are all that selection needs.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from experiments.effects.delay import LOOP_TIMING
from experiments.effects.effect import Effect
from experiments.effects.inertia import LINK_COM
from experiments.effects.link import BEARING_FRICTION
from experiments.measurement.evidence.atoms import Atoms

SMALL_STEP = 0.05  # of a strength's start, where the residual is close to linear in it
SIZES = (0.3, 1.0, 2.0, 3.0)  # of the start, for effects that are not


class Change(NamedTuple):
    """One effect's numbers, to be set at every place: `strength` is the one that scales the feature."""

    effect: Effect
    strength: str
    step: float
    shapes: tuple[tuple[str, float], ...]

    def values(self) -> dict[str, float]:
        return {**dict(self.shapes), self.strength: self.step}


class Variant(NamedTuple):
    """An effect with fixed shape parameters: a linear hypothesis, with one change for each of its strengths."""

    effect: Effect
    changes: tuple[int, ...]


# fitted beside every hypothesis, never one
NUISANCES = frozenset({LOOP_TIMING.name, LINK_COM.name, BEARING_FRICTION.name})

Seeds = Mapping[str, tuple[Mapping[str, float], ...]]  # starts of the shape parameters, by effect


def changes_of(
    effects: tuple[Effect, ...], logs: Sequence[Any] = (), points: Sequence[Any] = ()
) -> tuple[list[Change], list[Variant]]:
    """All changes to evaluate, and the linear hypotheses that they make; logs may bring starts of shapes at a point."""
    seeds = [log.seeds_at(point) for log, point in zip(logs, points, strict=True)]
    changes: list[Change] = []
    variants: list[Variant] = []
    for effect in effects:
        own = tuple(seed for found in seeds for seed in found.get(effect.name, ()))
        for shapes, size in _shapes_and_sizes(effect, own):
            found = []
            for strength in effect.strengths:
                found.append(len(changes))
                changes.append(Change(effect, strength.name, size * (strength.start or strength.high), shapes))
            if effect.name not in NUISANCES:
                variants.append(Variant(effect, tuple(found)))
    return changes, variants


def _shapes_and_sizes(
    effect: Effect, own: tuple[Mapping[str, float], ...]
) -> Iterator[tuple[tuple[tuple[str, float], ...], float]]:
    default = {p.name: p.start for p in effect.parameters if p.role == "shape"}
    strengths = {p.name for p in effect.strengths}
    seeds = own or ({}, *effect.seeds)
    shapes = {
        tuple(sorted({**default, **{k: v for k, v in seed.items() if k not in strengths}}.items())) for seed in seeds
    }
    curved = effect.sharp or (effect.memory and effect.name not in NUISANCES)
    sizes = SIZES if curved else (SMALL_STEP,)
    plain = tuple(sorted(default.items()))  # a nominal number is what the first change of its effect changes
    for shape in sorted(shapes, key=lambda shape: (shape != plain, shape)):
        for size in sizes:
            yield shape, size


def changed(atoms: Atoms, x: np.ndarray, change: Change, place: int | None = None) -> np.ndarray:
    """x with a change added: strengths move by it, shapes are set, at every place of its axis or at one."""
    x = x.copy()
    values = change.values()
    for column in atoms.of(change.effect.name):
        if column.parameter.name in values:
            here = slice(column.start, column.start + column.size)
            here = here if place is None else column.start + place
            moved = x[here] + values[column.parameter.name]
            x[here] = moved if column.parameter.name == change.strength else values[column.parameter.name]
    return x


@dataclass(frozen=True, eq=False)
class Products:
    """Inner products of columns per block: of features (by change and place), of nuisances and of the residual.

    gram (B, c, c) with the residual as the last column; feature (change k, place i) is column start[k] + i.
    prior (c,): inverse variance of a nuisance's coefficient, 0 for features.
    """

    gram: np.ndarray
    start: tuple[int, ...]
    nuisances: tuple[int, ...]
    prior: np.ndarray

    def direction(self, atoms: Atoms, variant: Variant, changes: list[Change], place: np.ndarray) -> np.ndarray:
        """(c, strengths): the columns that a hypothesis moves, scaled to the parameters' own units."""
        found = np.zeros((self.gram.shape[1], len(variant.changes)))
        for m, k in enumerate(variant.changes):
            found[self.start[k] : self.start[k] + len(place), m] = place / changes[k].step
        return found


class Gain(NamedTuple):
    """What adding a linear hypothesis does to chi^2 on some blocks."""

    gain: float
    values: np.ndarray  # (strengths,)


def projected(gram: np.ndarray, nuisances: list[np.ndarray], prior: np.ndarray) -> np.ndarray:
    """Gram matrix (c, c) with nuisance directions (each (c,)) fitted away, P = W - W G (G' W G + prior)^-1 G' W."""
    if not nuisances:
        return gram
    g = np.stack(nuisances, 1)
    left = gram @ g
    inner = g.T @ left + np.diag(prior)
    inner += 1e-9 * np.eye(len(inner)) * max(np.trace(inner) / len(inner), 1e-12)
    return gram - left @ np.linalg.solve(inner, left.T)


def gain(gram: np.ndarray, direction: np.ndarray) -> Gain:
    """Reduction of chi^2 when the columns in `direction` (c, p) are fitted to minus the residual (last column)."""
    moved = np.flatnonzero(direction.any(1))
    inner = direction[moved]
    h = inner.T @ gram[np.ix_(moved, moved)] @ inner
    g = -gram[-1, moved] @ inner
    scale = np.sqrt(np.maximum(np.diag(h), 1e-300))
    if not (np.diag(h) > 1e-12).all():
        alive = np.diag(h) > 1e-12
        if not alive.any():
            return Gain(0.0, np.zeros(len(g)))
        part = gain(gram, direction[:, alive])
        values = np.zeros(len(g))
        values[alive] = part.values
        return Gain(part.gain, values)
    values = np.linalg.solve(h / np.outer(scale, scale) + 1e-9 * np.eye(len(h)), g / scale) / scale
    return Gain(float(g @ values), values)
