"""What a finished search hands back."""

from typing import NamedTuple

import numpy as np

from es.progress import Generation, Progress, last_of_stage
from es.space import ParameterSpace
from es.stages import Stage


class StageResult(NamedTuple):
    """How one stage ended."""

    name: str
    best: np.ndarray  # (n,) best candidate evaluated in this stage, in the parameters' units
    best_cost: float  # its cost in its own generation; inf if no cost was finite
    generations: int
    converged: bool  # ended by the tolerance and not by its number of generations


class SearchResult(NamedTuple):
    """What a search found. The last stage counts: costs of different stages cannot be compared."""

    best: np.ndarray  # (n,) best candidate of the last stage, in the parameters' units
    best_cost: float  # its cost under the perturbations of its own generation: a little lucky if these are random
    mean: np.ndarray  # (n,) mean of the final distribution, in the parameters' units
    stages: tuple[StageResult, ...]
    history: tuple[Generation, ...]
    evaluations: int  # candidates evaluated, those before a resume included
    resumed_at: int  # generations that came from a checkpoint, 0 for a new search


class SearchFailed(ValueError):
    """No candidate of the last stage had a finite cost."""


def result_of(
    progress: Progress, space: ParameterSpace, stages: tuple[Stage, ...], population: int, resumed_at: int
) -> SearchResult:
    """The result of a finished search. Raises SearchFailed."""
    results = []
    for index, stage in enumerate(stages):
        last = last_of_stage(progress.history, index)
        count = sum(generation.stage == index for generation in progress.history)
        results.append(StageResult(stage.name, last.stage_best, last.stage_best_cost, count, count < stage.generations))
    if not np.isfinite(results[-1].best_cost):
        raise SearchFailed(
            f"no candidate of stage '{stages[-1].name}' had a finite cost in {results[-1].generations} generations; "
            "check the initial guess, the bounds and the cost"
        )
    mean = space.denormalise(np.asarray(progress.strategy.mean))
    evaluations = progress.generations * population
    return SearchResult(
        results[-1].best, results[-1].best_cost, mean, tuple(results), progress.history, evaluations, resumed_at
    )
