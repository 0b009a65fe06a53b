"""Trials of any gait under any disturbance with one compiled program: one second of the closed loop.

What tells two trials apart is data: the controller's numbers, the command, what disturbs, and for how long. So five
gaits with strides of 0.4 to 1.7 s share a program, and a robot that lies on the ground costs nothing more.
"""

from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from experiments.batch import batched, chunk_on, local_mesh
from experiments.imu_sensing import make_sensing
from experiments.model import Model
from experiments.plant import make_plant
from experiments.rollout import Rollout
from experiments.sensing import contact_flags
from experiments.tasks.definition import TaskDefinition
from experiments.tasks.gait import make_task
from experiments.tasks.gait_parameters import GaitSettings
from experiments.tasks.gait_score import GaitTally
from experiments.trial import Trial, noise_table

Array = jax.Array

SEGMENT = 400  # ticks, one second
SHORTEST_FLIGHT = 0.02  # s
CHUNK = 32  # trials of one device in one program (experiments.batch)


class Cases(NamedTuple):
    """Trials; every leaf has the trial axis first."""

    settings: GaitSettings  # the controller with the searched values in it
    numbers: dict[str, np.ndarray]  # (N,) each; the same names in all trials
    noise_start: np.ndarray  # (N,) int32
    duration: np.ndarray  # (N,) s

    def __len__(self) -> int:
        return len(self.duration)


class Outcome(NamedTuple):
    """What came of the trials."""

    tally: GaitTally  # (N,) each
    survived: np.ndarray  # (N,) 1.0 without a fall
    flights: np.ndarray  # (N,) flight phases a second, after settling
    flight_duration: np.ndarray  # (N,) their mean duration, s; NaN where there is none

    @property
    def speed(self) -> np.ndarray:
        """Mean heading and lateral velocity (N, 2) after settling, m/s."""
        return self.tally.velocity_C / np.maximum(self.tally.time, 1e-9)[:, None]

    @property
    def flight_fraction(self) -> np.ndarray:
        """Share of the time (N,) with all feet in the air, after settling."""
        return self.tally.flight / np.maximum(self.tally.time, 1e-9)


def gait_settings(definition: TaskDefinition, model: Model, values: np.ndarray) -> GaitSettings:
    """What the closed loop needs to know of a gait with searched values (n,), as NumPy leaves."""
    task = make_task(definition, model)
    controller = task.parameters(task.settings, jnp.asarray(values, jnp.float32))
    return jax.tree.map(np.asarray, task.settings._replace(controller=controller))


def cases(settings: GaitSettings, numbers: dict[str, np.ndarray], noise_start: np.ndarray, duration: float) -> Cases:
    """Trials (N,) of one gait."""
    count = len(noise_start)
    many = jax.tree.map(lambda x: np.repeat(np.asarray(x)[None], count, 0), settings)
    return Cases(many, numbers, noise_start, np.full(count, duration))


def joined(parts: list[Cases]) -> Cases:
    """All trials of several sets, one after the other."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


class GaitTrials:
    """The compiled program; `run` takes any number of trials of any gaits of one robot."""

    def __init__(
        self,
        model: Model,
        definition: TaskDefinition,
        devices: int | None = None,
        drive: str = "full",
        chunk: int = CHUNK,
    ) -> None:
        task = make_task(definition, model)
        free = replace(task, name="any gait", names=(), ticks=SEGMENT)
        self.rollout = Rollout(make_plant(model, drive), free, make_sensing("estimated", model))
        self.mesh = local_mesh(devices)
        self.chunk = chunk_on(self.mesh, chunk)

    @cached_property
    def _begin(self):
        def begin(noise: Array, case: Cases) -> Any:
            trial = Trial(case.numbers, noise, case.noise_start)
            return self.rollout.begin(self.rollout.plant.params, case.settings, jnp.zeros(0), trial)[1]

        return batched(begin, self.mesh, self.chunk)

    @cached_property
    def _go_on(self):
        rollout, none = self.rollout, jnp.zeros(0)

        def go_on(shared: tuple[Array, Array], member: tuple[Cases, Any]) -> tuple[Any, Array]:
            (noise, first), (case, carry) = shared, member
            trial = Trial(case.numbers, noise, case.noise_start)
            params = rollout.plant.prepare(trial.apply(rollout.plant, rollout.plant.params))

            def tick(carry, k):
                after, observed = rollout.tick(params, case.settings, none, trial, carry, k)
                on = observed.time < case.duration  # afterwards nothing counts any more
                tally = jax.tree.map(lambda new, old: jnp.where(on, new, old), after[3], carry[3])
                aloft = 1.0 - contact_flags(observed.after.contact_force, rollout.task.contact_force).max()
                return (*after[:3], tally, after[4]), jnp.where(on, aloft, 0.0)

            return jax.lax.scan(tick, carry, first + jnp.arange(SEGMENT))

        return batched(go_on, self.mesh, self.chunk)

    def run(self, todo: Cases) -> Outcome:
        """All trials to their end, or to their fall."""
        noise = np.asarray(noise_table())
        carry = self._begin(noise, todo)
        settled, period = self.rollout.task.settled, self.rollout.task.period
        seconds = int(np.ceil(todo.duration.max() / (SEGMENT * period) - 1e-6))
        aloft = np.zeros((len(todo), seconds * SEGMENT), bool)
        for second in range(seconds):
            fallen = (carry[3].fallen > 0) | (carry[4] == 0)
            here = np.flatnonzero(~fallen & (todo.duration > second * SEGMENT * period))
            if not len(here):
                break
            part, now = jax.tree.map(lambda x, here=here: x[here], (todo, carry))
            now, off = self._go_on((noise, np.int32(second * SEGMENT)), (part, now))
            carry = jax.tree.map(lambda whole, new, here=here: _put(whole, here, new), carry, now)
            aloft[here, second * SEGMENT : (second + 1) * SEGMENT] = off > 0
        survived = 1.0 - np.maximum(carry[3].fallen, 1.0 - carry[4])
        count, duration = flight_phases(aloft[:, round(settled / period) :], period)
        return Outcome(carry[3], survived, count / np.maximum(carry[3].time, period), duration)


def flight_phases(aloft: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Number and mean duration (N,) s of the flights in aloft (N, ticks of `period` s); NaN where there is none.

    A flicker of the contact flags, shorter than SHORTEST_FLIGHT, is no flight.
    """
    count, duration = np.zeros(len(aloft)), np.full(len(aloft), np.nan)
    for n, row in enumerate(np.pad(aloft.astype(int), ((0, 0), (1, 1)))):
        start, end = np.flatnonzero(np.diff(row)).reshape(-1, 2).T
        lasts = period * (end - start)
        lasts = lasts[lasts >= SHORTEST_FLIGHT]
        if len(lasts):
            count[n], duration[n] = len(lasts), lasts.mean()
    return count, duration


def _put(whole: np.ndarray, here: np.ndarray, new: np.ndarray) -> np.ndarray:
    whole = whole.copy()
    whole[here] = new
    return whole
