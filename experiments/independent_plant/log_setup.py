"""What makes the logs of a batch: hidden effects, the robot's own numbers, how it is measured, how it begins."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from experiments.independent_plant import leg_geometry
from experiments.independent_plant.bodies import BodyChanges, slope_quaternion
from experiments.independent_plant.hooks import Family, hooked
from experiments.independent_plant.library import Effect, families_of
from experiments.independent_plant.numbers import Array, BodyNumbers
from experiments.independent_plant.sensors import SensorSettings


@dataclass(frozen=True)
class LogSetup:
    """What makes one log of a batch: its hidden effects, its own numbers, how it is measured."""

    seed: int
    effects: tuple[Effect, ...] = ()
    off: dict[str, tuple[float, float, float]] = field(default_factory=dict)  # number -> factor per joint kind
    bodies: BodyNumbers = field(default_factory=BodyNumbers)
    sensors: SensorSettings = field(default_factory=SensorSettings)
    velocity_phase: int = 0  # steps of 0.1 ms by which the velocity loop runs later than the rows
    end_stops: bool = True


@dataclass
class Start:
    """At rest at the beginning: (B, 12) rad and N m, (B, 3) m, (B, 4)."""

    joint_position: Array
    spring_torque: Array
    torso_position: Array
    torso_orientation: Array


def standing(setups: Sequence[LogSetup], height: float) -> Start:
    """On four feet below the hips, on the ground as it is under each log."""
    batch = len(setups)
    angles = leg_geometry.stance_angles(np.full(batch, height))
    families = families_of([s.effects for s in setups], [np.random.default_rng(0) for _ in setups])
    attitude = np.array([slope_quaternion(change) for change in changes_of(setups, families)])
    up = leg_geometry.rotation(attitude)[:, :, 2]
    _, jacobian = leg_geometry.feet(angles)
    share = np.array([0.0, 0.0, leg_geometry.TOTAL_MASS * leg_geometry.GRAVITY / 4.0])
    torque = -np.einsum("blij,i->blj", jacobian, share).reshape(batch, 12)
    return Start(angles, torque, height * up, attitude)


def hanging(angles: Array) -> Start:
    """Clamped torso, springs unloaded, at joint angles (B, 12)."""
    batch = len(angles)
    return Start(angles, np.zeros((batch, 12)), np.zeros((batch, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (batch, 1)))


def changes_of(setups: Sequence[LogSetup], families: list[Family]) -> list[BodyChanges]:
    changes = [BodyChanges(end_stops=setup.end_stops) for setup in setups]
    for family in hooked(families, "change_bodies"):
        for log, change in enumerate(changes):
            family.change_bodies(log, change)
    return changes
