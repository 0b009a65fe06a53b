"""From true signals to a row of the log: sampling jitter, noise, quantisation (format: see logs.py)."""

from dataclasses import dataclass

import numpy as np

from experiments.independent_plant.numbers import Array

WIDTH = {
    "joint_position": 12,
    "joint_velocity": 12,
    "motor_position": 12,
    "motor_velocity": 12,
    "joint_torque": 12,
    "motor_current": 12,
    "applied_torque": 12,
    "base_position": 3,
    "base_orientation": 4,
    "base_linear_velocity": 3,
    "base_angular_velocity": 3,
    "base_acceleration": 3,
}
NOISE_STD = {
    "joint_position": 2e-4,
    "joint_velocity": 0.02,
    "motor_position": 5e-5,
    "motor_velocity": 0.01,
    "joint_torque": 0.05,
    "motor_current": 0.05,
    "applied_torque": 0.05,
    "base_position": 5e-4,
    "base_orientation": 5e-4,
    "base_linear_velocity": 0.01,
    "base_angular_velocity": 0.005,
    "base_acceleration": 0.05,
}
# Steps of the encoders and converters; each adds well under a third of its channel's noise.
QUANTUM = {
    "joint_position": 1e-4,
    "joint_velocity": 1e-3,
    "motor_position": 1e-5,
    "motor_velocity": 1e-3,
    "joint_torque": 1e-2,
    "motor_current": 1e-2,
    "applied_torque": 1e-2,
    "base_position": 1e-4,
    "base_orientation": 1e-5,
    "base_linear_velocity": 1e-3,
    "base_angular_velocity": 1e-3,
    "base_acceleration": 1e-2,
}


@dataclass(frozen=True)
class SensorSettings:
    """How well one log is measured."""

    noise: float = 1.0  # times NOISE_STD
    quantised: bool = True
    jitter: float = 0.0  # s, standard deviation of the sampling instant, not logged


class Sensors:
    """Draws all noise beforehand, log by log, so that a log does not depend on its neighbours in the batch."""

    def __init__(
        self, settings: list[SensorSettings], rngs: list[np.random.Generator], rows: int, names: list[str]
    ) -> None:
        self.noise = {name: np.empty((len(settings), rows, WIDTH[name])) for name in names}
        self.jitter = np.empty((len(settings), rows))
        self.quantum = {name: np.array([[QUANTUM[name] if s.quantised else 0.0] for s in settings]) for name in names}
        for i, (setting, rng) in enumerate(zip(settings, rngs)):
            self.jitter[i] = setting.jitter * rng.standard_normal(rows)
            for name in names:
                draw = rng.standard_normal((rows, WIDTH[name]))
                self.noise[name][i] = setting.noise * NOISE_STD[name] * draw

    def row(self, k: int, now: dict[str, Array], before: dict[str, Array], apart: float) -> dict[str, Array]:
        """Row k, from the true signals at the tick and `apart` seconds before it."""
        shift = self.jitter[:, k, None] / apart
        seen = {}
        for name in self.noise:
            value = now[name]
            value = value + shift * (value - before[name]) + self.noise[name][:, k]
            step = self.quantum[name]
            seen[name] = np.where(step > 0.0, np.round(value / np.where(step > 0.0, step, 1.0)) * step, value)
        return seen
