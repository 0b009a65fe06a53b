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
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from es import bounds, cma_es
from es.checkpoint import Checkpointer, CheckpointError
from es.checks import check_count, check_number
from es.progress import Progress, begin, enter_stage, from_arrays, summary, to_arrays
from es.result import SearchResult, result_of
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


class SearchInterrupted(Exception):
    """Ctrl-C: the generation under way was dropped, the ones before it are in the last checkpoint."""

    def __init__(self, generations: int, total: int, where: str | None) -> None:
        self.generations = generations  # finished
        self.where = where  # the checkpoints' folder, None without a checkpointer
        kept = f"the checkpoint in {where} continues it" if where and generations else "nothing was saved"
        super().__init__(f"the search was interrupted after {generations} of at most {total} generations; {kept}")


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
    if checkpointer is not None:
        checkpointer.open(describe(space, stages, settings, key))
    arrays = None if checkpointer is None else checkpointer.load()
    loop = _Loop.over(evaluate, space, stages, settings, key)
    progress = begin(space, settings.population, settings.sigma)
    if arrays is not None:
        progress = _resumed(arrays, progress, len(stages), checkpointer.directory)
    resumed_at = progress.generations
    try:
        while progress.stage < len(stages):
            progress, aux = loop.next_generation(progress)
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
    return result_of(progress, space, stages, settings.population, resumed_at)


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


@dataclass(frozen=True)
class _Loop:
    """What stays the same from generation to generation."""

    evaluate: Evaluate
    space: ParameterSpace
    stages: tuple[Stage, ...]
    settings: SearchSettings
    engine: "CMA_ES"
    draw_key: jax.Array  # on the search's device
    evaluation_key: jax.Array  # on no device in particular, as the caller may use any
    high: jax.Array  # upper corner of the normalised box, on the search's device

    @classmethod
    def over(
        cls,
        evaluate: Evaluate,
        space: ParameterSpace,
        stages: tuple[Stage, ...],
        settings: SearchSettings,
        key: jax.Array,
    ) -> "_Loop":
        device = cma_es.search_device()
        draw_key = jax.device_put(jax.random.fold_in(key, DRAW_STREAM), device)
        evaluation_key = jax.random.fold_in(key, EVALUATION_STREAM)
        engine = cma_es.make_engine(settings.population, space.size)
        high = jax.device_put(space.normalised_high, device)
        return cls(evaluate, space, stages, settings, engine, draw_key, evaluation_key, high)

    def next_generation(self, progress: Progress) -> tuple[Progress, Any]:
        """Draw, evaluate, learn; the progress after it and the caller's aux."""
        index, population = np.int32(progress.generations), self.settings.population
        redraws = np.int32(self.settings.redraws)
        draw, strategy = bounds.ask(self.engine, progress.strategy, self.draw_key, index, self.high, redraws)
        candidates = self.space.denormalise(np.asarray(draw.inside))

        costs, aux = self.evaluate(self.stages[progress.stage], candidates, _fold_in(self.evaluation_key, index))
        costs = np.asarray(costs)
        if costs.shape != (population,):
            raise ValueError(f"evaluate must return {population} costs, not an array of shape {costs.shape}")
        charged = costs + self.settings.bound_penalty * np.asarray(draw.distance, np.float64)
        strategy = cma_es.tell(self.engine, strategy, draw.told, charged.astype(np.float32))

        generation = summary(progress, self.space, draw, candidates, costs)
        progress = Progress(strategy, progress.stage, progress.stage_generations + 1, (*progress.history, generation))
        return self._with_stage(progress), aux

    def _with_stage(self, progress: Progress) -> Progress:
        """The same progress, or the beginning of the next stage if this one converged or used its generations."""
        spent = progress.stage_generations >= self.stages[progress.stage].generations
        if not spent and cma_es.widest_deviation(progress.strategy) >= self.settings.tolerance:
            return progress
        progress = progress._replace(stage=progress.stage + 1, stage_generations=0)
        if progress.stage == len(self.stages):
            return progress
        return enter_stage(progress, self.stages[progress.stage])


_fold_in = jax.jit(jax.random.fold_in)
