"""Scores of many candidates under many trials: what the search, the robustness analysis and re-evaluation call."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from experiments.batch import batched, chunk_on, in_slices
from experiments.distributed import gathered, share
from experiments.effects.effect import Effect
from experiments.imu_sensing import make_sensing
from experiments.model import Model
from experiments.plant import Plant, PlantParams, make_plant
from experiments.rollout import Rollout, Score, Task
from experiments.sensing import Sensing
from experiments.tasks.definition import TaskDefinition
from experiments.tasks.registry import make_task
from experiments.trial import Trial, noise_table
from sea_jax import with_torque_limits

Array = jax.Array

SLICE = 1024  # members on the host at a time: bounds memory whatever their number


class Members(NamedTuple):
    """What differs from one rollout to the next; every leaf has the member axis first."""

    values: np.ndarray  # (N, n)
    numbers: dict[str, np.ndarray]  # (N,) each
    noise_start: np.ndarray  # (N,) int32


def unwatched(task: Task, plant: Plant) -> Task:
    """The task as it is."""
    return task


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One task on one plant, compiled once for any number of members of the same kind."""

    model: Model
    definition: TaskDefinition
    drive: str
    library: Mapping[str, Effect]
    mesh: jax.sharding.Mesh
    chunk: int  # on CPU devices
    sensing: Sensing | None = None  # that of the task's last stage unless given
    watched: Callable[[Task, Plant], Task] = unwatched  # what else of a rollout is scored

    @cached_property
    def members_per_chunk(self) -> int:
        """A member's last bit depends on its place among these."""
        return chunk_on(self.mesh, self.chunk)

    @cached_property
    def rollout(self) -> Rollout:
        plant = make_plant(self.model, self.drive, dict(self.library))
        sensing = self.sensing or make_sensing(self.definition.stages[-1].sensing, self.model)
        return Rollout(plant, self.watched(make_task(self.definition, self.model), plant), sensing)

    @staticmethod
    def outcome(rollout: Rollout, params: PlantParams, settings: Any, values: Array, trial: Trial) -> Any:
        """What is wanted of one rollout."""
        return rollout.score(params, settings, values, trial)

    @cached_property
    def _program(self) -> Callable[[Any, Members], Any]:
        rollout = self.rollout

        def one(shared, member: Members) -> Any:
            params, settings, noise = shared
            trial = Trial(member.numbers, noise, member.noise_start)
            return self.outcome(rollout, params, settings, member.values, trial)

        return batched(one, self.mesh, self.members_per_chunk)

    def scores(self, members: Members, torque_limit: float = 1.0) -> Score:
        """Scores of all members, NumPy leaves with the member axis first; each process runs its share of them."""
        params, settings = self.limited(torque_limit)
        shared = (params, settings, noise_table())
        mine = share(members, self.members_per_chunk)
        few = len(mine.values) <= SLICE
        scores = self._program(shared, mine) if few else in_slices(self._program, shared, mine, SLICE)
        return gathered(scores, len(members.values))

    def limited(self, torque_limit: float = 1.0) -> tuple[PlantParams, Any]:
        """Plant and controller with the joint torque limits scaled (the real drives have limits of their own)."""
        params, settings = self.rollout.plant.params, self.rollout.task.settings
        limits = settings.geometry.torque_limits * jnp.float32(torque_limit)
        settings = settings._replace(
            geometry=settings.geometry._replace(torque_limits=limits),
            distribution=settings.distribution._replace(torque_limits=limits),
        )
        return params._replace(drive=with_torque_limits(params.drive, limits[:, 0], limits[:, 1])), settings


def crossed(candidates: np.ndarray, numbers: Mapping[str, np.ndarray], noise_start: np.ndarray) -> Members:
    """Every candidate (P, n) under every trial (K): P*K members, trials running fastest."""
    count, trials = len(candidates), len(noise_start)
    return Members(
        np.repeat(np.asarray(candidates, np.float32), trials, axis=0),
        {name: np.tile(values, count) for name, values in numbers.items()},
        np.tile(noise_start, count),
    )
