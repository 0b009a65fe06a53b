"""How far a search has come: an immutable value, replaced once a generation, and its view as named arrays."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from es import cma_es
from es.space import ParameterSpace
from es.stages import Stage

if TYPE_CHECKING:
    from evosax.algorithms.distribution_based.cma_es import State

    from es.bounds import Draw


class Generation(NamedTuple):
    """What is kept of one generation. Costs are the caller's, without the charge for leaving the bounds."""

    stage: int  # index of the stage
    best_cost: float  # lowest of this generation, inf if none was finite
    mean_cost: float  # of the finite ones, inf if none was
    stage_best_cost: float  # lowest of the stage so far
    stage_best: np.ndarray  # (n,) its parameters in their units
    mean: np.ndarray  # (n,) of the distribution the candidates were drawn from, in the parameters' units
    sigma: float  # step size, normalised
    widest_deviation: float  # standard deviation along the longest axis, normalised
    failed: int  # candidates whose cost was not finite
    redraws: int  # of all candidates together
    projected: int  # candidates that no redraw brought inside


class Progress(NamedTuple):
    """Everything that the rest of the search depends on, apart from what the caller passes to `search`."""

    strategy: "State"
    stage: int  # index of the stage the next generation belongs to; the number of stages when all are done
    stage_generations: int  # done in that stage
    history: tuple[Generation, ...]

    @property
    def generations(self) -> int:
        """Done in all stages."""
        return len(self.history)


def begin(space: ParameterSpace, population: int, sigma: float) -> Progress:
    """Progress before the first generation: the initial guess and sigma in every direction."""
    engine = cma_es.make_engine(population, space.size)
    return Progress(cma_es.start(engine, space.normalise(space.initial), sigma), 0, 0, ())


def enter_stage(progress: Progress, stage: Stage) -> Progress:
    """Progress at the door of a stage after the first: the distribution widened as the stage asks."""
    strategy = cma_es.reenter(progress.strategy, stage.sigma_rescale, stage.sigma_floor)
    return progress._replace(strategy=strategy)


def summary(
    progress: Progress, space: ParameterSpace, draw: "Draw", candidates: np.ndarray, costs: np.ndarray
) -> Generation:
    """What is remembered of a generation drawn from `progress`; any cost that is not finite is a failure."""
    finite = np.isfinite(costs)
    best = int(np.argmin(np.where(finite, costs, np.inf)))
    best_cost = float(costs[best]) if finite.any() else np.inf
    stage_best_cost, stage_best = best_cost, candidates[best]
    if progress.stage_generations > 0 and progress.history[-1].stage_best_cost <= best_cost:
        stage_best_cost, stage_best = progress.history[-1].stage_best_cost, progress.history[-1].stage_best
    return Generation(
        stage=progress.stage,
        best_cost=best_cost,
        mean_cost=float(np.mean(costs[finite], dtype=np.float64)) if finite.any() else np.inf,
        stage_best_cost=stage_best_cost,
        stage_best=stage_best,
        mean=space.denormalise(np.asarray(progress.strategy.mean)),
        sigma=float(progress.strategy.std),
        widest_deviation=cma_es.widest_deviation(progress.strategy),
        failed=int(np.sum(~finite)),
        redraws=int(np.sum(draw.redraws)),
        projected=int(np.sum(np.asarray(draw.distance) > 0.0)),
    )


def last_of_stage(history: Sequence[Generation], stage: int) -> Generation:
    """The last generation of a stage that has been under way; it carries the stage's best."""
    return next(generation for generation in reversed(history) if generation.stage == stage)


def to_arrays(progress: Progress) -> dict[str, np.ndarray]:
    """Flat, named arrays from which `from_arrays` makes the same progress to the bit."""
    arrays = {f"strategy.{name}": np.asarray(leaf) for name, leaf in vars(progress.strategy).items()} | {
        "position": np.array([progress.stage, progress.stage_generations], np.int64),
    }
    columns = zip(*progress.history) if progress.history else ((),) * len(Generation._fields)
    for name, column in zip(Generation._fields, columns, strict=True):
        arrays[f"history.{name}"] = np.asarray(column)
    return arrays


def from_arrays(arrays: Mapping[str, np.ndarray], fresh: Progress, stages: int) -> Progress:
    """Progress from its arrays; `fresh` (of the same search) gives the shapes. ValueError if they do not fit."""
    stage, stage_generations = (int(number) for number in _take(arrays, "position", np.zeros(2, np.int64)))
    strategy = fresh.strategy.replace(
        **{name: _take(arrays, f"strategy.{name}", leaf) for name, leaf in vars(fresh.strategy).items()}
    )
    columns = {name: arrays.get(f"history.{name}", np.zeros(0)) for name in Generation._fields}
    length = len(columns["stage"])
    for name, column in columns.items():
        expected = (length, strategy.mean.size) if name in ("stage_best", "mean") else (length,)
        if column.shape != expected:
            raise ValueError(f"'history.{name}' has the shape {column.shape} in place of {expected}")
    rows = zip(*(list(c) if c.ndim > 1 else c.tolist() for c in columns.values()), strict=True)
    progress = Progress(cma_es.on_search_device(strategy), stage, stage_generations, tuple(map(Generation._make, rows)))
    if not 0 <= stage <= stages or stage_generations != sum(row.stage == stage for row in progress.history):
        raise ValueError("its position does not agree with its history")
    return progress


def _take(arrays: Mapping[str, np.ndarray], name: str, like: Any) -> np.ndarray:
    """The named array, if it has the shape and type of `like`."""
    if name not in arrays:
        raise ValueError(f"'{name}' is missing")
    array = arrays[name]
    if array.shape != like.shape or array.dtype != like.dtype:
        raise ValueError(f"'{name}' is {array.dtype}{array.shape} in place of {like.dtype}{like.shape}")
    return array
