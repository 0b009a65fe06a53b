"""Gradient refinement of a parameter vector: Adam in normalised coordinates, projected to the bounds."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import optax

from es.checks import check_count, check_number
from es.numerics import library_numerics
from es.space import ParameterSpace

ValueAndGrad = Callable[[np.ndarray], tuple[Any, Any]]


@dataclass(frozen=True)
class RefineSettings:
    """Settings of the descent. ValueError if one makes no sense."""

    steps: int = 50
    learning_rate: float = 0.01  # largest first step, normalised (of the range, with the default scale)
    clip_norm: float = 1.0  # gradients (cost per normalised unit) longer than this are shortened to it
    patience: int = 5  # evaluations in a row that may fail before the descent is given up

    def __post_init__(self) -> None:
        check_count("steps", self.steps, at_least=1)
        check_number("learning_rate", self.learning_rate, above=0.0)
        check_number("clip_norm", self.clip_norm, above=0.0)
        check_count("patience", self.patience, at_least=1)


class Step(NamedTuple):
    """One evaluation of the descent."""

    cost: float
    gradient_norm: float  # normalised, before clipping
    failed: bool  # cost or gradient was not finite
    learning_rate: float  # normalised


class Refined(NamedTuple):
    """What the descent found."""

    best: np.ndarray  # (n,) in the parameters' units: the initial vector if nothing was better
    best_cost: float
    initial_cost: float
    history: tuple[Step, ...]
    gave_up: bool  # `patience` evaluations in a row failed, or the first had no gradient

    @property
    def improved(self) -> bool:
        """Whether the descent lowered the cost at all."""
        return self.best_cost < self.initial_cost


def refine(
    value_and_grad: ValueAndGrad,
    space: ParameterSpace,
    initial: np.ndarray,
    settings: RefineSettings,
    on_step: Callable[[Step], None] | None = None,
) -> Refined:
    """Descend from `initial` (n,); `value_and_grad(x)` gives cost () and gradient (n,) in the parameters' units.

    A cost or gradient that is not finite is an answer like another: the descent goes back to the best point that had
    a gradient, forgets its momentum and halves its step. Raises ValueError if `initial` is out of bounds or has no
    finite cost.
    """
    space.named(initial)  # refuses what is out of bounds
    adam = optax.scale_by_adam()
    schedule = optax.cosine_decay_schedule(settings.learning_rate, settings.steps)
    y = space.normalise(initial)
    momentum = fresh = adam.init(jnp.asarray(y))
    best, history, anchor = Point(y, np.inf, y), [], None
    failures, in_a_row = 0, 0

    for index in range(settings.steps + 1):  # the last evaluation judges the last step
        point = _evaluate(value_and_grad, space, y)
        failed = not (np.isfinite(point.cost) and np.all(np.isfinite(point.slope)))
        with library_numerics():
            rate = float(schedule(index)) * 0.5**failures
        history.append(Step(point.cost, float(np.linalg.norm(point.slope)), failed, rate))
        if on_step is not None:
            on_step(history[-1])
        if not np.isfinite(history[0].cost):
            raise ValueError("the cost at the point to be refined is not finite, so there is nothing to refine")
        if point.cost < best.cost and np.isfinite(point.cost):
            best = point
        if not failed and (anchor is None or point.cost < anchor.cost):
            anchor = point
        failures, in_a_row = failures + failed, in_a_row + 1 if failed else 0
        if anchor is None or in_a_row >= settings.patience:
            break
        base, momentum, rate = (anchor, fresh, rate / 2) if failed else (point, momentum, rate)
        with library_numerics():
            step, momentum = adam.update(_clipped(base.slope, settings.clip_norm), momentum)
        y = np.clip(base.y - np.float32(rate) * np.asarray(step), 0.0, space.normalised_high)
    return Refined(
        space.denormalise(best.y), best.cost, history[0].cost, tuple(history), len(history) <= settings.steps
    )


class Point(NamedTuple):
    """A place, normalised, and what is known there."""

    y: np.ndarray  # (n,)
    cost: float
    slope: np.ndarray  # (n,) cost per normalised unit, float64


def _evaluate(value_and_grad: ValueAndGrad, space: ParameterSpace, y: np.ndarray) -> Point:
    cost, gradient = value_and_grad(space.denormalise(y))
    gradient = np.asarray(gradient)
    if np.shape(cost) != () or gradient.shape != (space.size,):
        raise ValueError(
            f"value_and_grad must return a cost and {space.size} derivatives, not the shapes {np.shape(cost)} and "
            f"{gradient.shape}"
        )
    return Point(y, float(cost), gradient.astype(np.float64) * space.scale)


def _clipped(slope: np.ndarray, longest: float) -> jnp.ndarray:
    """Shortened to `longest`; in float64, as the square of a long gradient overflows float32 and would clip to 0."""
    return jnp.asarray(slope / max(1.0, float(np.linalg.norm(slope)) / longest), jnp.float32)
