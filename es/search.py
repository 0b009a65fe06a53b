"""The generation loop: ask, evaluate, tell, remember; interruptible at any moment and resumable to the same bits.

The caller supplies `evaluate(stage, candidates, generation_key) -> (costs, aux)`:
`candidates` (P, n) float32 NumPy array in the parameters' units, within their bounds, in the order of the space;
`generation_key` a JAX key, one for all candidates of a generation (common random numbers), another each generation;
`costs` (P,) of which NaN and inf mean that the candidate failed; `aux` anything, handed on to `on_generation`.
Perturbations, sharding over devices and reduction over trials are the caller's; what `evaluate` returns must depend on
its arguments only.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from es import bounds, cma_es
from es.checkpoint import Checkpointer, CheckpointError
from es.checks import check_count, check_number
from es.progress import Generation, Progress, begin, enter_stage, from_arrays, last_of_stage, to_arrays
from es.space import ParameterSpace
from es.stages import Stage, check_stages

if TYPE_CHECKING:
    from evosax.algorithms.distribution_based.cma_es import CMA_ES

Evaluate = Callable[[Stage, np.ndarray, jax.Array], tuple[Any, Any]]
OnGeneration = Callable[[Progress, Any], None]

# What a search draws and what its caller draws must not be the same numbers.
DRAW_STREAM, EVALUATION_STREAM = 0, 1


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the strategy. ValueError if one makes no sense."""

    population: int = 15  # candidates per generation
    sigma: float = 0.25  # initial standard deviation, normalised (of the range, with the default scale)
    redraws: int = 1000  # of a candidate out of bounds, before it is projected
    bound_penalty: float = 10.0  # cost per normalised distance to the bounds, for projected candidates
    tolerance: float = 1e-5  # a stage ends when the longest axis' standard deviation is below this, normalised

    def __post_init__(self) -> None:
        check_count("population", self.population, at_least=cma_es.SMALLEST_POPULATION)
        check_number("sigma", self.sigma, above=0.0, below=cma_es.LARGEST_SIGMA)
        check_count("redraws", self.redraws, at_least=0)
        check_number("bound_penalty", self.bound_penalty, at_least=0.0)
        # float32 resolves 6e-8 of the box
        check_number("tolerance", self.tolerance, at_least=1e-7)


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


class SearchInterrupted(Exception):
    """Ctrl-C: the generation under way was dropped, the ones before it are in the last checkpoint."""

    def __init__(self, generations: int, total: int, where: str | None) -> None:
        self.generations = generations  # finished
        self.where = where  # the checkpoints' folder, None without a checkpointer
        kept = f"the checkpoint in {where} continues it" if where and generations else "nothing was saved"
        super().__init__(f"the search was interrupted after {generations} of at most {total} generations; {kept}")


class SearchFailed(ValueError):
    """No candidate of the last stage had a finite cost."""


def search(
    evaluate: Evaluate,
    space: ParameterSpace,
    stages: Sequence[Stage],
    settings: SearchSettings,
    key: jax.Array,
    on_generation: OnGeneration | None = None,
    checkpointer: Checkpointer | None = None,
) -> SearchResult:
    """Minimise `evaluate`'s cost through all stages; see the top of this file for what `evaluate` gets and returns.

    With a checkpointer that holds a checkpoint of this very search, continues it to the result of the uninterrupted
    one, to the bit. `on_generation(progress, aux)` is called after every generation.
    Raises ValueError (settings, stages, costs), CheckpointError (unusable, of another search, or not writable),
    SearchInterrupted (KeyboardInterrupt once the first generation has begun), SearchFailed.
    """
    stages = check_stages(stages)
    key = _without_device(key)
    arrays = None
    if checkpointer is not None:
        checkpointer.open(describe(space, stages, settings, key))
        arrays = checkpointer.load()
    engine = cma_es.make_engine(settings.population, space.size)
    progress = begin(space, settings.population, settings.sigma)
    if arrays is not None:
        progress = _resumed(arrays, progress, len(stages), checkpointer.directory)
    resumed_at = progress.generations
    try:
        while progress.stage < len(stages):
            progress, aux = _next_generation(evaluate, engine, space, stages, settings, key, progress)
            if on_generation is not None:
                on_generation(progress, aux)
            if checkpointer is not None and (checkpointer.due() or progress.stage == len(stages)):
                checkpointer.save(progress.generations, to_arrays(progress))
    except KeyboardInterrupt:
        if checkpointer is not None and progress.generations > 0:
            checkpointer.save(progress.generations, to_arrays(progress))
        where = None if checkpointer is None else str(checkpointer.directory)
        total = sum(stage.generations for stage in stages)
        raise SearchInterrupted(progress.generations, total, where) from None
    return _result(progress, space, stages, settings, resumed_at)


def describe(
    space: ParameterSpace, stages: Sequence[Stage], settings: SearchSettings, key: jax.Array
) -> dict[str, Any]:
    """What makes a search this search and no other, as JSON values: a checkpoint of another one is refused."""
    return {
        "parameters": {"order": list(space.names)} | space.describe(),
        "stages": {"order": [stage.name for stage in stages]} | {stage.name: stage.describe() for stage in stages},
        "settings": asdict(settings),
        "key": np.asarray(jax.random.key_data(key)).tolist(),
        "versions": {package: version(package) for package in ("jax", "jaxlib", "evosax")},
    }


def _without_device(key: jax.Array) -> jax.Array:
    """The key free to be used on any device; ValueError if it is not one typed JAX key."""
    if not (isinstance(key, jax.Array) and jax.dtypes.issubdtype(key.dtype, jax.dtypes.prng_key) and key.ndim == 0):
        raise ValueError("the search's key must be a single key made by jax.random.key(seed)")
    return jax.random.wrap_key_data(np.asarray(jax.random.key_data(key)), impl=jax.random.key_impl(key))


def _resumed(arrays: Mapping[str, np.ndarray], fresh: Progress, stages: int, directory: Path) -> Progress:
    """The progress that a checkpoint holds."""
    try:
        return from_arrays(arrays, fresh, stages)
    except ValueError as error:
        raise CheckpointError(f"the checkpoint in {directory} does not fit this search: {error}") from None


def _next_generation(
    evaluate: Evaluate,
    engine: "CMA_ES",
    space: ParameterSpace,
    stages: tuple[Stage, ...],
    settings: SearchSettings,
    key: jax.Array,
    progress: Progress,
) -> tuple[Progress, Any]:
    """One generation: draw, evaluate, learn. Returns the progress after it and the caller's aux."""
    stage = stages[progress.stage]
    draw_key, evaluation_key = (
        jax.random.fold_in(jax.random.fold_in(key, stream), progress.generations)
        for stream in (DRAW_STREAM, EVALUATION_STREAM)
    )
    device = cma_es.search_device()
    high = jax.device_put(space.normalised_high, device)
    draw, strategy = bounds.ask(
        engine, progress.strategy, jax.device_put(draw_key, device), high, np.int32(settings.redraws)
    )
    candidates = space.denormalise(np.asarray(draw.inside))

    costs, aux = evaluate(stage, candidates, evaluation_key)
    costs = np.asarray(costs)
    if costs.shape != (settings.population,):
        raise ValueError(f"evaluate must return {settings.population} costs, not an array of shape {costs.shape}")
    charged = costs + settings.bound_penalty * np.asarray(draw.distance, np.float64)
    strategy = cma_es.tell(engine, strategy, draw.told, charged.astype(np.float32))

    generation = _summary(progress, space, draw, candidates, costs)
    progress = Progress(strategy, progress.stage, progress.stage_generations + 1, (*progress.history, generation))
    return _after_generation(progress, stages, settings), aux


def _summary(
    progress: Progress, space: ParameterSpace, draw: bounds.Draw, candidates: np.ndarray, costs: np.ndarray
) -> Generation:
    """What is remembered of the generation; a cost that is not finite, even -inf, is a failure and never the best."""
    finite = np.isfinite(costs)
    ranked = np.where(finite, costs, np.inf)
    best = int(np.argmin(ranked))
    best_cost, best_candidate = float(ranked[best]), candidates[best]
    if progress.stage_best_cost <= best_cost and progress.stage_generations > 0:
        stage_best_cost, stage_best = progress.stage_best_cost, progress.history[-1].stage_best
    else:
        stage_best_cost, stage_best = best_cost, best_candidate
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


def _after_generation(progress: Progress, stages: tuple[Stage, ...], settings: SearchSettings) -> Progress:
    """The same progress, or the beginning of the next stage if this one has converged or used its generations."""
    spent = progress.stage_generations >= stages[progress.stage].generations
    if not spent and not _converged(progress, settings):
        return progress
    progress = progress._replace(stage=progress.stage + 1, stage_generations=0)
    return enter_stage(progress, stages[progress.stage]) if progress.stage < len(stages) else progress


def _converged(progress: Progress, settings: SearchSettings) -> bool:
    return cma_es.widest_deviation(progress.strategy) < settings.tolerance


def _result(
    progress: Progress, space: ParameterSpace, stages: tuple[Stage, ...], settings: SearchSettings, resumed_at: int
) -> SearchResult:
    """The result of a finished search."""
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
    evaluations = progress.generations * settings.population
    return SearchResult(
        results[-1].best, results[-1].best_cost, mean, tuple(results), progress.history, evaluations, resumed_at
    )
