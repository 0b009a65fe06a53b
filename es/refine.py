"""Gradient refinement: slopes of a smooth approximation say where to go, the true cost says how far, and whether.

Each step draws one slope, makes two directions of it, Adam's and the steepest, tries a ladder of lengths along both
at the true cost, all at once, and goes to the best of these points if it is better than where it stands. So the cost
never rises, however wrong a slope is, and what is accepted was measured and not predicted.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import optax

from es.checks import check_count, check_number
from es.numerics import library_numerics
from es.space import ParameterSpace

Slope = Callable[[np.ndarray, int], Any]  # (values (n,), step) -> (n,) cost per unit of each parameter
Costs = Callable[[np.ndarray], Any]  # (P, n) values -> (P,)


@dataclass(frozen=True)
class RefineSettings:
    """Settings of the descent. ValueError if one makes no sense."""

    steps: int = 50
    length: float = 0.01  # of the first step, normalised (of the range, with the default scale)
    longest: float = 0.1  # of any step
    shortest: float = 2e-3  # that a ladder is centred on: a ragged cost has a little to gain everywhere
    patience: int = 10  # steps in a row without a better point, after which the descent is over
    rungs: int = 8  # lengths tried along each direction, each half of the one before

    def __post_init__(self) -> None:
        check_count("steps", self.steps, at_least=1)
        check_number("length", self.length, above=0.0)
        check_number("longest", self.longest, above=0.0)
        check_number("shortest", self.shortest, above=0.0)
        check_count("patience", self.patience, at_least=1)
        check_count("rungs", self.rungs, at_least=1)

    @property
    def population(self) -> int:
        """Points tried in each step."""
        return 2 * self.rungs


class Step(NamedTuple):
    """One step of the descent."""

    cost: float  # true cost after it
    tried: float  # best of the points tried
    slope_norm: float  # normalised; NaN where the slope was not finite
    length: float  # of the step taken, normalised; 0 where none was better


class Descent(NamedTuple):
    """Everything that the next step depends on."""

    y: np.ndarray  # (n,) normalised
    cost: float
    initial_cost: float
    length: float  # where the next ladder is centred
    momentum: Any  # Adam's
    history: tuple[Step, ...]

    def idle(self, steps: int) -> bool:
        """Whether none of the last so many steps found a better point."""
        return len(self.history) >= steps and not any(step.length for step in self.history[-steps:])


class Refined(NamedTuple):
    """What the descent found."""

    best: np.ndarray  # (n,) in the parameters' units: the initial vector if nothing was better
    best_cost: float
    initial_cost: float
    history: tuple[Step, ...]

    @property
    def improved(self) -> bool:
        """Whether the descent lowered the cost at all."""
        return self.best_cost < self.initial_cost

    @property
    def course(self) -> np.ndarray:
        """(steps + 1,) true cost before the first step and after each."""
        return np.array([self.initial_cost, *(step.cost for step in self.history)])


def begin(costs: Costs, space: ParameterSpace, initial: np.ndarray, settings: RefineSettings) -> Descent:
    """Before the first step from `initial` (n,). Raises ValueError if it is out of bounds or has no finite cost."""
    space.named(initial)  # refuses what is out of bounds
    cost = float(np.asarray(costs(np.repeat(np.asarray(initial)[None], settings.population, 0)))[0])
    if not np.isfinite(cost):
        raise ValueError("the cost at the point to be refined is not finite, so there is nothing to refine")
    return Descent(space.normalise(initial), cost, cost, settings.length, _no_momentum(space.size), ())


def refine(
    slope: Slope,
    costs: Costs,
    space: ParameterSpace,
    initial: np.ndarray,
    settings: RefineSettings,
    on_step: Callable[[Descent], None] | None = None,
    resumed: Descent | None = None,
) -> Refined:
    """Descend from `initial` (n,) on `costs`, or go on from a descent that `on_step` got.

    A slope or a cost that is not finite is an answer like another: no step is taken on it.
    Raises ValueError if `initial` is out of bounds or has no finite cost.
    """
    descent = resumed or begin(costs, space, initial, settings)
    while len(descent.history) < settings.steps and not descent.idle(settings.patience):
        descent = advance(slope, costs, space, settings, descent)
        if on_step is not None:
            on_step(descent)
    moved = descent.cost < descent.initial_cost
    best = space.denormalise(descent.y) if moved else np.asarray(initial, np.float32)
    return Refined(best, descent.cost, descent.initial_cost, descent.history)


def advance(slope: Slope, costs: Costs, space: ParameterSpace, settings: RefineSettings, descent: Descent) -> Descent:
    """One step."""
    gradient = np.asarray(slope(space.denormalise(descent.y), len(descent.history)), np.float64)
    if gradient.shape != (space.size,):
        raise ValueError(f"slope must return {space.size} derivatives, not the shape {gradient.shape}")
    gradient = gradient * space.scale
    norm = float(np.linalg.norm(gradient))
    if not np.isfinite(norm) or norm == 0.0:
        return _stay(settings, descent, Step(descent.cost, np.inf, norm, 0.0))
    steepest = gradient / norm
    with library_numerics():
        step, momentum = optax.scale_by_adam().update(jnp.asarray(steepest, jnp.float32), descent.momentum)
    adam = np.asarray(step, np.float64)
    directions = np.stack([adam / np.linalg.norm(adam), steepest])

    lengths = np.minimum(2.0 * descent.length, settings.longest) * 0.5 ** np.arange(settings.rungs)
    points = descent.y - lengths[:, None, None] * directions[None]
    points = np.clip(points.reshape(-1, space.size), 0.0, space.normalised_high).astype(np.float32)
    found = np.asarray(costs(space.denormalise(points)), np.float64)
    if found.shape != (len(points),):
        raise ValueError(f"costs must return {len(points)} costs, not an array of shape {found.shape}")
    found = np.where(np.isfinite(found), found, np.inf)
    best = int(np.argmin(found))
    if not found[best] < descent.cost:
        return _stay(settings, descent, Step(descent.cost, float(found[best]), norm, 0.0))
    cost, length = float(found[best]), float(lengths[best // 2])
    history = (*descent.history, Step(cost, cost, norm, length))
    centre = max(length, settings.shortest)
    return descent._replace(y=points[best], cost=cost, length=centre, momentum=momentum, history=history)


def _stay(settings: RefineSettings, descent: Descent, step: Step) -> Descent:
    """The same point with a shorter ladder and no momentum."""
    fresh = _no_momentum(len(descent.y))
    length = max(0.5 * descent.length, settings.shortest)
    return descent._replace(length=length, momentum=fresh, history=(*descent.history, step))


def _no_momentum(size: int) -> Any:
    with library_numerics():
        return optax.scale_by_adam().init(jnp.zeros(size, jnp.float32))
