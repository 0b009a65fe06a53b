"""`starleth replay`: run a tuned motion again on any drive and any of three engines, and say how it did."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.effects.effect import Effect
from experiments.errors import UserError
from experiments.imu_sensing import make_sensing
from experiments.model import Model
from experiments.parameter_file import parameters_at, read_parameters
from experiments.parameter_schema import ParameterFile
from experiments.plant import make_plant
from experiments.rollout import Rollout, Score, Tick
from experiments.stepping import ENGINES, run_with_engine
from experiments.tasks.definition import TaskDefinition, task_of
from experiments.tasks.registry import make_task, metric_units
from experiments.trial import nominal_trial


@dataclass(frozen=True)
class Motion:
    """A parameter file with the task that it belongs to."""

    file: ParameterFile
    definition: TaskDefinition

    @property
    def values(self) -> np.ndarray:
        return self.definition.space().vector(self.file.values())


def load_motion(source: Path, model: Model, task: str | None = None) -> Motion:
    """A run's folder or a parameters.json, gated or not: this is simulation.

    task: the user's own task file, if it was tuned with one. Raises UserError, also for parameters of another model
    or task.
    """
    path = parameters_at(source)
    file = read_parameters(path, model_hash=model.hash(), allow_ungated=True)
    return Motion(file, task_of(file, path, task))


def initial_guess(definition: TaskDefinition) -> np.ndarray:
    """The task's values before any search."""
    return definition.space().initial


def replay(
    values: np.ndarray, definition: TaskDefinition, model: Model, drive: str, engine: str, library: dict[str, Effect]
) -> tuple[Score, Tick]:
    """One nominal trial, tick by tick (NumPy leaves). Raises UserError."""
    if engine not in ENGINES:
        raise UserError(f"No engine '{engine}'; choose one of {', '.join(ENGINES)}.")
    plant = make_plant(model, drive, library)
    rollout = Rollout(plant, make_task(definition, model), make_sensing(definition.stages[-1].sensing, model))
    trial = plant.params, rollout.task.settings, jnp.asarray(values, jnp.float32), nominal_trial()
    if engine == "moreau":
        return jax.tree.map(np.asarray, jax.jit(rollout.record)(*trial))
    try:
        return run_with_engine(engine, rollout, *trial)
    except ValueError as error:  # a ground that it does not know
        raise UserError(str(error)) from None


def summary(score: Score, definition: TaskDefinition, model: Model, drive: str, engine: str) -> dict[str, Any]:
    """What `replay` prints: metrics, cost and its terms, and what they belong to."""
    units = metric_units(definition.task)
    metrics = {
        name: bool(value > 0.5) if units[name] == "bool" else round(float(value), 6)
        for name, value in score.metrics.items()
    }
    return {
        "task": definition.task,
        "drive": drive,
        "engine": engine,
        **metrics,
        "cost": round(float(score.cost), 6),
        "cost_terms": {name: round(float(value), 6) for name, value in score.terms.items()},
        "model_hash": model.hash(),
    }
