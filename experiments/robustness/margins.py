"""How far a motion stays from the robot's limits: a task that also keeps the peaks of what the drives and joints do."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from controller_jax.types import JointTargets, RobotState
from experiments.plant import Plant, PlantParams, PlantState
from experiments.rollout import Score, Task, Tick
from experiments.trial import Trial

Array = jax.Array

MARGIN_UNITS = {
    "margin_joint_stop": "rad",
    "margin_torque": "1",
    "margin_speed": "1",
    "margin_current": "1",
    "margin_voltage": "1",
    "margin_power": "1",
}


class Limits(NamedTuple):
    """The nominal robot's limits, (12,) each: a weak battery or another motor does not move the yardstick."""

    position: Array  # (12, 2) rad, the mechanical stops
    torque: Array  # N m, of the stronger side
    speed: Array  # rad/s, gear output side
    current: Array  # A
    voltage: Array  # V
    power: Array  # W


class Peaks(NamedTuple):
    """Largest use of each limit so far, () as a share; the joint stop as the least distance."""

    joint_stop: Array  # rad, negative beyond the stop
    torque: Array
    speed: Array
    current: Array
    voltage: Array
    power: Array


class WatchedTally(NamedTuple):
    """The task's own tally and the peaks."""

    task: Any
    peaks: Peaks


@dataclass(frozen=True, eq=False)
class WithMargins:
    """A task whose score has the margins of MARGIN_UNITS among its metrics; it moves exactly as without them."""

    task: Task
    limits: Limits

    @property
    def name(self) -> str:
        return self.task.name

    @property
    def ticks(self) -> int:
        return self.task.ticks

    @property
    def settings(self) -> Any:
        return self.task.settings

    def start(
        self, plant: Plant, params: PlantParams, settings: Any, values: Array, trial: Trial
    ) -> tuple[PlantState, Any]:
        return self.task.start(plant, params, settings, values, trial)

    def control(
        self, settings: Any, values: Array, state: Any, robot: RobotState, time: Array
    ) -> tuple[Any, JointTargets, Any]:
        return self.task.control(settings, values, state, robot, time)

    def first_tally(self) -> WatchedTally:
        zero = jnp.zeros(())
        return WatchedTally(self.task.first_tally(), Peaks(zero + 10.0, zero, zero, zero, zero, zero))

    def observe(self, tally: WatchedTally, tick: Tick) -> WatchedTally:
        p, limits, drive = tally.peaks, self.limits, tick.output.drive
        q, speed = tick.after.bodies.q[7:], tick.after.drive.motor_velocity
        room = jnp.minimum(q - limits.position[:, 0], limits.position[:, 1] - q).min()
        peaks = Peaks(
            joint_stop=jnp.minimum(p.joint_stop, room),
            torque=_more(p.torque, drive.torque, limits.torque),
            speed=_more(p.speed, speed, limits.speed),
            current=_more(p.current, drive.peak_current, limits.current),
            voltage=_more(p.voltage, drive.peak_voltage, limits.voltage),
            power=_more(p.power, jnp.maximum(drive.torque * speed, 0.0), limits.power),
        )
        return WatchedTally(self.task.observe(tally.task, tick), peaks)

    def score(self, values: Array, tally: WatchedTally, failed: Array, last: PlantState) -> Score:
        score = self.task.score(values, tally.task, failed, last)
        p = tally.peaks
        margins = {"margin_joint_stop": p.joint_stop}
        margins |= {f"margin_{name}": 1.0 - getattr(p, name) for name in Peaks._fields[1:]}
        return score._replace(metrics=score.metrics | margins)


def _more(peak: Array, value: Array, limit: Array) -> Array:
    return jnp.maximum(peak, (jnp.abs(value) / limit).max())


def with_margins(task: Task, plant: Plant) -> WithMargins:
    """The task watched against the limits of the plant's nominal numbers."""
    drive, geometry = plant.params.drive, task.settings.geometry
    limits = Limits(
        position=jnp.asarray(plant.params.bodies.joint_stop),
        torque=np.abs(geometry.torque_limits).max(1),
        speed=drive.speed_limit,
        current=drive.current_limit,
        voltage=drive.bus_voltage,
        power=drive.power_limit,
    )
    return WithMargins(task, Limits(*(jnp.asarray(x, jnp.float32) for x in limits)))
