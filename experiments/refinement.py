"""`tune --refine`: from a finished search downhill, on slopes of the smooth rollout and costs of the true one.

The true cost is that of the last stage: its full model, its trials, its risk. The slope is a mean over several smooth
rollouts, of the trials that count and of points close by: the cost of a jump is ragged at the scale of a control
period, and one slope there says little about the next thousandth of a range.

The search's result is on disk before this begins. Each step is kept in refinement.json, from which a killed refinement
goes on.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from es import Descent, Refined, RefineSettings, reduce_costs, refine
from es.refine import Step
from experiments.distributed import is_first
from experiments.errors import UserError
from experiments.evaluation import Members, crossed
from experiments.files import first_complaint, read_json, write_json
from experiments.run_folder import RunFolder
from experiments.smooth.rollout import SmoothEvaluation

if TYPE_CHECKING:
    from experiments.tune import StagedEvaluation

FILE = "refinement.json"
MAX_BYTES = 10_000_000
STREAM = 15_485_863  # trials of the refinement: neither those of the search nor those that judge
SAMPLES = 4  # smooth rollouts for one slope, at least
SPREAD = 0.003  # of each range: how far apart they are
CHUNK = 4


class RefinementInterrupted(Exception):
    """Ctrl-C; the steps so far are in the file."""

    def __init__(self, steps: int) -> None:
        self.steps = steps
        super().__init__(f"the refinement was interrupted after {steps} steps")


class Refinement(NamedTuple):
    """A refinement as export and report see it."""

    found: Refined
    kept: bool  # it also did better on trials that it has not seen


def verdict(found: Refined, kept: bool) -> str:
    """What became of it, in one line."""
    course = f"{found.initial_cost:.3f} \N{RIGHTWARDS ARROW} {found.best_cost:.3f}"
    if not found.improved:
        return f"The refinement did not lower the cost ({found.initial_cost:.3f}); the search's result is kept."
    if not kept:
        return f"Refined: {course} on its trials, but no better on unseen ones; the search's result is kept."
    return f"Refined: {course}."


class TrueCost:
    """Cost of candidates on the last stage's plant and trials, and the slope there of its smooth counterpart."""

    def __init__(self, evaluation: "StagedEvaluation", population: int) -> None:
        options = evaluation.options
        self.stage, self.risk, self.seed = options.definition.stages[-1], options.risk, options.seed
        self.space, self.population = options.definition.space(), population
        self.hard = evaluation.on(self.stage.drive, self.stage.sensing)
        mesh, model = evaluation.mesh, options.perturbed_model
        self.smooth = SmoothEvaluation(model, options.definition, self.stage.drive, options.library, mesh, CHUNK)
        key = jax.random.fold_in(jax.random.key(options.seed), STREAM)
        trials = options.trials(key, self.stage.trials) if self.stage.perturbed else options.nominal()
        self.numbers, self.noise = trials
        self._seen: dict[bytes, np.ndarray] = {}

    def costs(self, candidates: np.ndarray) -> np.ndarray:
        """(P, n) to (P,)."""
        members = crossed(candidates, self.numbers, self.noise)
        costs = self.hard.scores(members, self.stage.torque_limit).cost.reshape(len(candidates), -1)
        self._seen = {x.tobytes(): row for x, row in zip(candidates, costs, strict=True)}
        return np.asarray(reduce_costs(costs, self.risk))

    def slope(self, values: np.ndarray, step: int) -> np.ndarray:
        """(n,): over the trials that count in the risk, each at points close by; NaN where none is finite."""
        weights = self._weights(values)
        trials = np.flatnonzero(weights)
        each = -(-SAMPLES // len(trials))
        members = self._near(values, np.repeat(trials, each), step)
        slopes = self.smooth.slopes(members, self.stage.torque_limit).astype(np.float64) * self.space.scale
        sizes = np.linalg.norm(slopes, axis=1)
        good = np.isfinite(sizes)
        if not good.any():
            return np.full(self.space.size, np.nan)
        # one rollout that meets a cliff must not outvote all others
        typical = np.median(sizes[good])
        shortened = slopes * np.minimum(1.0, typical / np.maximum(sizes, np.finfo(float).tiny))[:, None]
        share = np.where(good, np.repeat(weights[trials] / each, each), 0.0)
        return (share[:, None] * np.where(good[:, None], shortened, 0.0)).sum(0) / share.sum() / self.space.scale

    def _weights(self, values: np.ndarray) -> np.ndarray:
        """(K,) how much each trial counts at these values."""
        if values.tobytes() not in self._seen:
            self.costs(np.repeat(values[None], self.population, 0))
        costs = self._seen[values.tobytes()]
        weights = np.empty(len(costs))
        weights[np.argsort(costs)] = self.risk.weights(len(costs))
        return weights

    def _near(self, values: np.ndarray, trials: np.ndarray, step: int) -> Members:
        """The values, each but the first a little off, under the trials of these indices."""
        offsets = np.random.default_rng((self.seed, step)).normal(size=(len(trials), self.space.size))
        offsets[0] = 0.0
        points = values + SPREAD * (self.space.high - self.space.low) * offsets
        points = np.clip(points, self.space.low, self.space.high).astype(np.float32)
        return Members(points, {name: column[trials] for name, column in self.numbers.items()}, self.noise[trials])


def descend(
    evaluation: "StagedEvaluation",
    run: RunFolder,
    start: np.ndarray,
    steps: int,
    on_step: Callable[[Descent], None],
    notify: Callable[[str], None],
) -> Refined:
    """Refine from `start` (n,) in so many steps, or go on where the run's file ends.

    Raises UserError, RefinementInterrupted.
    """
    settings = RefineSettings(steps=steps)
    cost = TrueCost(evaluation, settings.population)
    before = _load(run / FILE, start, notify)
    taken = 0 if before is None else len(before.history)

    def after(descent: Descent) -> None:
        nonlocal taken
        taken = len(descent.history)
        if is_first():
            _save(run / FILE, start, descent)
        on_step(descent)

    try:
        return refine(cost.slope, cost.costs, cost.space, start, settings, after, before)
    except ValueError as error:
        raise UserError(f"{error}.") from None
    except KeyboardInterrupt:
        raise RefinementInterrupted(taken) from None


class _Record(BaseModel):
    """What refinement.json holds: the last step's state, all of it."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    start: Annotated[list[FiniteFloat], Field(max_length=1000)]
    y: Annotated[list[FiniteFloat], Field(max_length=1000)]
    cost: FiniteFloat
    initial_cost: FiniteFloat
    length: Annotated[FiniteFloat, Field(gt=0)]
    count: Annotated[int, Field(ge=0, lt=2**31)]
    mean: Annotated[list[FiniteFloat], Field(max_length=1000)]
    square: Annotated[list[FiniteFloat], Field(max_length=1000)]
    history: Annotated[
        list[tuple[FiniteFloat, FiniteFloat | None, FiniteFloat | None, FiniteFloat]], Field(max_length=1_000_000)
    ]


def _save(path: Path, start: np.ndarray, descent: Descent) -> None:
    momentum = descent.momentum
    history = [[_finite(number) for number in step] for step in descent.history]
    record = {
        "start": np.asarray(start, float).tolist(),
        "y": descent.y.astype(float).tolist(),
        "cost": descent.cost,
        "initial_cost": descent.initial_cost,
        "length": descent.length,
        "count": int(momentum.count),
        "mean": np.asarray(momentum.mu, float).tolist(),
        "square": np.asarray(momentum.nu, float).tolist(),
        "history": history,
    }
    write_json(path, record)


def _finite(number: float) -> float | None:
    return float(number) if np.isfinite(number) else None


def _load(path: Path, start: np.ndarray, notify: Callable[[str], None]) -> Descent | None:
    """The state in the file, if it is one of a refinement from the same start."""
    if not path.exists():
        return None
    try:
        # through JSON, as a strict model takes a list for a tuple only there
        record = _Record.model_validate(_as_tuples(read_json(path, MAX_BYTES)))
    except (UserError, ValidationError) as error:
        why = str(error) if isinstance(error, UserError) else first_complaint(error)
        notify(f"{path.name} cannot be used ({why}); the refinement begins anew.")
        return None
    sizes = {len(record.start), len(record.y), len(record.mean), len(record.square)}
    if sizes != {len(start)} or np.float32(record.start).tobytes() != np.asarray(start, np.float32).tobytes():
        notify(f"{path.name} is of a refinement from another start; this one begins anew.")
        return None
    momentum = optax.ScaleByAdamState(
        jnp.int32(record.count), jnp.asarray(record.mean, jnp.float32), jnp.asarray(record.square, jnp.float32)
    )
    nothing = (0.0, np.inf, np.nan, 0.0)
    steps = tuple(
        Step(*(other if number is None else number for number, other in zip(step, nothing, strict=True)))
        for step in record.history
    )
    return Descent(np.float32(record.y), record.cost, record.initial_cost, record.length, momentum, steps)


def _as_tuples(content: Any) -> Any:
    if isinstance(content, dict) and isinstance(content.get("history"), list):
        return content | {"history": [tuple(step) if isinstance(step, list) else step for step in content["history"]]}
    return content
