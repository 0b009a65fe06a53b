"""Hidden effects in what is commanded and in what is measured."""

from typing import ClassVar

import numpy as np

from experiments.independent_plant.drive import Command
from experiments.independent_plant.hooks import Family
from experiments.independent_plant.numbers import Array, nominal_drive

JOINT_SIGNALS = (
    "joint_position",
    "joint_velocity",
    "motor_position",
    "motor_velocity",
    "joint_torque",
    "motor_current",
)
BASE_SIGNALS = (
    "base_position",
    "base_orientation",
    "base_linear_velocity",
    "base_angular_velocity",
    "base_acceleration",
)


def _stiffness(batch: int) -> Array:
    return nominal_drive(batch).spring_stiffness


class Past:
    """Signals of the last 0.1 s, looked up at any time in between by linear interpolation."""

    KEPT = 0.1  # s

    def __init__(self) -> None:
        self.times: list[float] = []
        self.values: list[Array] = []

    def push(self, time: float, value: Array) -> None:
        self.times.append(time)
        self.values.append(np.array(value))
        if self.times[-1] - self.times[0] > self.KEPT:
            del self.times[0], self.values[0]

    def at(self, time: Array) -> Array:
        """Value at each element's own time; before the first one, the first one. NaN only where both are."""
        times = np.array(self.times)
        after = np.clip(np.searchsorted(times, time), 1, max(len(times) - 1, 1))
        if len(times) == 1:
            return self.values[0].copy()
        stack = np.stack(self.values)
        late, early = (np.take_along_axis(stack, (after - back)[None], axis=0)[0] for back in (0, 1))
        share = np.clip((time - times[after - 1]) / (times[after] - times[after - 1]), 0.0, 1.0)
        mixed = late * share + early * (1.0 - share)
        return np.where(np.isnan(mixed), np.where(share >= 0.5, late, early), mixed)


class CommandDelay(Family):
    name = "command_delay"
    about = "commands reach the joint controllers late; between two ticks, in proportion"
    units: ClassVar = {"delay": "s"}
    scaled = "delay"

    def __init__(self, batch: int) -> None:
        super().__init__(batch)
        self.torques, self.positions = Past(), Past()
        self.stiffness = _stiffness(batch)

    def command(self, time: float, command: Command) -> Command:
        self.torques.push(time, command.torque)
        self.positions.push(time, command.position)
        late = self.delay > 0.0
        torque = np.where(late, self.torques.at(time - self.delay), command.torque)
        position = np.where(late, self.positions.at(time - self.delay), command.position)
        self.torque = np.nan_to_num(torque - command.torque) + self.stiffness * np.nan_to_num(
            position - command.position
        )
        return Command(torque, position)


class JointEncoderOffset(Family):
    name = "joint_encoder_offset"
    about = "the joint encoder reads too much by `offset`"
    units: ClassVar = {"offset": "rad"}
    scaled = "offset"

    def __init__(self, batch: int) -> None:
        super().__init__(batch)
        self.stiffness = _stiffness(batch)

    def measure(self, time: float, signals: dict[str, Array]) -> dict[str, Array]:
        self.torque = self.stiffness * self.offset
        return signals | {"joint_position": signals["joint_position"] + self.offset}


class TorqueSensorGain(Family):
    name = "torque_sensor_gain"
    about = "the torque sensor reads (1 + change) times the joint torque"
    units: ClassVar = {"change": "-"}
    scaled = "change"

    def measure(self, time: float, signals: dict[str, Array]) -> dict[str, Array]:
        self.torque = self.change * signals["joint_torque"]
        return signals | {"joint_torque": signals["joint_torque"] + self.torque}


class TorqueSensorOffset(Family):
    name = "torque_sensor_offset"
    about = "the torque sensor reads too much by `offset`"
    units: ClassVar = {"offset": "N m"}
    scaled = "offset"

    def measure(self, time: float, signals: dict[str, Array]) -> dict[str, Array]:
        self.torque = self.offset.copy()
        return signals | {"joint_torque": signals["joint_torque"] + self.offset}


class SensorDelay(Family):
    name = "sensor_delay"
    about = "all six joint signals (at `torso`: all base signals) are measured late"
    units: ClassVar = {"delay": "s"}
    places = ("joints", "torso")
    scaled = "delay"

    def __init__(self, batch: int) -> None:
        super().__init__(batch)
        self.base_delay = np.zeros((batch, 1))
        self.past: dict[str, Past] = {}
        self.stiffness = _stiffness(batch)

    def add(self, log: int, where: str, parameters: dict[str, float], rng: np.random.Generator) -> None:
        if where == "torso":
            self.base_delay[log] = self.checked(parameters)["delay"]
        else:
            super().add(log, where, parameters, rng)

    def remember(self, time: float, signals: dict[str, Array]) -> None:
        for name, value in signals.items():
            if name in JOINT_SIGNALS + BASE_SIGNALS:
                self.past.setdefault(name, Past()).push(time, value)

    def measure(self, time: float, signals: dict[str, Array]) -> dict[str, Array]:
        seen = dict(signals)
        for name, past in self.past.items():
            delay = self.delay if name in JOINT_SIGNALS else np.broadcast_to(self.base_delay, signals[name].shape)
            seen[name] = np.where(delay > 0.0, past.at(time - delay), signals[name])
        self.torque = self.stiffness * (seen["joint_position"] - signals["joint_position"])
        return seen
