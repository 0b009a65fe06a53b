"""The closed loop of one trial: sense, control, drive, move, score, for so many ticks of 2.5 ms (paper Fig. 2)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from controller_jax.types import JointTargets, RobotState
from experiments.plant import Plant, PlantInput, PlantOutput, PlantParams, PlantState
from experiments.sensing import Sensing
from experiments.trial import Trial, noise_row, push_at
from sea_jax import JointCommand, JointMeasurement

Array = jax.Array

SANE_SPEED = 200.0  # m/s or rad/s: beyond this a rollout has diverged, and its state is frozen


class Task(Protocol):
    """What a motion task brings to the closed loop. All methods are pure and see one environment.

    `settings` is the controller's pytree of numbers that are not searched (torque limits, gains, geometry).
    """

    name: str
    ticks: int
    settings: Any

    def start(
        self, plant: Plant, params: PlantParams, settings: Any, values: Array, trial: Trial
    ) -> tuple[PlantState, Any]:
        """Plant and controller at time zero for parameter values (n,)."""

    def control(
        self, settings: Any, values: Array, state: Any, robot: RobotState, time: Array
    ) -> tuple[Any, JointTargets, Any]:
        """One control period: (controller state, targets, info)."""

    def first_tally(self) -> Any:
        """What the score accumulates, before the first tick."""

    def observe(self, tally: Any, tick: "Tick") -> Any:
        """Add one tick to the tally."""

    def score(self, values: Array, tally: Any, failed: Array, last: PlantState) -> "Score":
        """Cost, its terms and metrics from the tally."""


class Tick(NamedTuple):
    """Everything that happened in one control period."""

    time: Array  # s, at its start
    before: PlantState
    after: PlantState
    robot: RobotState  # as the controller saw it
    measurement: JointMeasurement
    targets: JointTargets
    info: Any
    output: PlantOutput
    alive: Array  # 1.0 until the rollout diverges


class Decision(NamedTuple):
    """What a control period begins with, before the plant moves."""

    time: Array  # s, at its start
    sensed: PlantState
    sensing: Any  # estimator's state
    robot: RobotState
    controller: Any  # controller's state
    targets: JointTargets
    info: Any
    inputs: PlantInput


class Score(NamedTuple):
    """What a rollout is worth."""

    cost: Array  # ()
    terms: dict[str, Array]  # weighted cost terms; their sum is the cost
    metrics: dict[str, Array]


@dataclass(frozen=True, eq=False)
class Rollout:
    """Static half of a closed loop."""

    plant: Plant
    task: Task
    sensing: Sensing

    def score(self, params: PlantParams, settings: Any, values: Array, trial: Trial) -> Score:
        """Run one trial with parameter values (n,) and score it; a diverging one is scored, never NaN."""
        return self._run(params, settings, values, trial, lambda tick: None)[0]

    def record(self, params: PlantParams, settings: Any, values: Array, trial: Trial) -> tuple[Score, Tick]:
        """Run one trial and keep every tick: (score, ticks stacked along axis 0)."""
        return self._run(params, settings, values, trial, lambda tick: tick)

    def begin(self, params: PlantParams, settings: Any, values: Array, trial: Trial) -> tuple[PlantParams, Any]:
        """(the trial's plant, what the ticks carry before the first)."""
        params = self.plant.prepare(trial.apply(self.plant, params))
        state, controller = self.task.start(self.plant, params, settings, values, trial)
        alive = jnp.ones((), jnp.float32)
        return params, (state, controller, self.sensing.start(state), self.task.first_tally(), alive)

    def tick(
        self, params: PlantParams, settings: Any, values: Array, trial: Trial, carry: Any, k: Array
    ) -> tuple[Any, Tick]:
        """Control period k of a trial; params and carry as `begin` gave them."""
        decision = self.decide(params, settings, values, trial, carry, k)
        return self.conclude(carry, decision, self.plant.step(params, decision.sensed, decision.inputs))

    def decide(
        self, params: PlantParams, settings: Any, values: Array, trial: Trial, carry: Any, k: Array
    ) -> "Decision":
        """Sense and control: what acts on the plant in control period k."""
        state, controller, sensing, _, _ = carry
        time = k.astype(jnp.float32) * self.plant.periods.control
        noise = noise_row(trial, k)
        sensed, measurement = self.plant.measure(params, state)
        sensing, robot, measurement = self.sensing.step(sensing, sensed, measurement, noise)
        controller, targets, info = self.task.control(settings, values, controller, robot, time)
        command = JointCommand(targets.torque, targets.position, targets.position_mode)
        inputs = PlantInput(command, measurement, push_at(trial, time))
        return Decision(time, sensed, sensing, robot, controller, targets, info, inputs)

    def conclude(self, carry: Any, decision: "Decision", moved: tuple[PlantState, PlantOutput]) -> tuple[Any, Tick]:
        """What the plant has come to, taken into the tally; frozen from where it diverges on."""
        state, _, _, tally, alive = carry
        after, output = moved
        alive = alive * _sane(after)
        after = jax.tree.map(lambda new, old: jnp.where(alive > 0, new, old), after, state)
        d = decision
        observed = Tick(d.time, state, after, d.robot, d.inputs.measurement, d.targets, d.info, output, alive)
        tally = jax.tree.map(lambda new, old: jnp.where(alive > 0, new, old), self.task.observe(tally, observed), tally)
        return (after, d.controller, d.sensing, tally, alive), observed

    def _run(
        self, params: PlantParams, settings: Any, values: Array, trial: Trial, keep: Callable[[Tick], Any]
    ) -> tuple[Score, Any]:
        params, first = self.begin(params, settings, values, trial)

        def tick(carry, k):
            carry, observed = self.tick(params, settings, values, trial, carry, k)
            return carry, keep(observed)

        (last, _, _, tally, alive), kept = jax.lax.scan(tick, first, jnp.arange(self.task.ticks))
        return self.task.score(values, tally, 1.0 - alive, last), kept


def as_float(condition: Array) -> Array:
    """1.0 where true."""
    return condition.astype(jnp.float32)


def _sane(state: PlantState) -> Array:
    """1.0 while the state is finite and its speeds are possible."""
    speed = jnp.abs(state.bodies.u).max()
    whole = jnp.isfinite(state.bodies.q.sum() + state.drive.motor_position.sum() + state.drive.current.sum())
    return as_float(whole & (speed < SANE_SPEED))
