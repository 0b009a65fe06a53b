"""The load of a single joint on a bench: J ddq = torque - b dq - G sin q, with Coulomb friction that sticks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.independent_plant.bodies import BodyChanges
from experiments.independent_plant.drive import STEP
from experiments.independent_plant.numbers import Array

# kg m^2, N m s/rad, N m of the benches, by the joint kind whose drive turns them
LOADS = {"HAA": (0.12, 0.02, 1.5), "HFE": (0.06, 0.02, 1.0), "KFE": (0.03, 0.01, 0.5), "rigid": (0.3, 0.4, 2.0)}


@dataclass(frozen=True)
class Load:
    """What a bench joint turns."""

    inertia: float  # kg m^2
    viscous_friction: float  # N m s/rad
    gravity_load: float  # N m at 90 degrees from hanging down

    def off(self, factors: Sequence[float]) -> "Load":
        """The load as it is, where the numbers file is off by three factors."""
        own = (self.inertia, self.viscous_friction, self.gravity_load)
        return Load(*(value * factor for value, factor in zip(own, factors, strict=True)))


class BenchBodies:
    """Twelve loads per log, each on its own axis; the same face to the plant as Bodies."""

    free = False

    def __init__(self, loads: Sequence[Load], changes: Sequence[BodyChanges]) -> None:
        self.inertia = np.array([[load.inertia] for load in loads])
        self.gravity = np.array([[load.gravity_load] for load in loads])
        self.viscous = np.array([load.viscous_friction + c.viscous_drag for load, c in zip(loads, changes)])
        self.coulomb = np.array([change.coulomb_drag for change in changes])
        self.position, self.velocity = np.zeros((len(loads), 12)), np.zeros((len(loads), 12))

    def place(self, joint_position: Array, torso_position: Array, torso_orientation: Array) -> None:
        """At rest at the given angles (B, 12)."""
        self.position, self.velocity = joint_position.copy(), np.zeros_like(joint_position)

    def step(self, torque: Array) -> None:
        """One 0.1 ms under joint torques (B, 12), N m."""
        push = torque - self.gravity * np.sin(self.position)
        before, velocity = self.velocity, stick_slip(self.velocity, push, self.coulomb, self.viscous, self.inertia)
        self.velocity = velocity
        self.position = self.position + 0.5 * STEP * (before + velocity)

    def radial_load(self) -> Array:
        """A bench's bearing carries next to nothing across."""
        return np.zeros_like(self.position)

    def fallen(self) -> Array:
        """Whether a log left all reason."""
        return ~(np.abs(self.velocity).max(axis=1) < 100.0)


def stick_slip(speed: Array, push: Array, level: Array, viscous: Array | float, inertia: Array) -> Array:
    """Speed after one step under a driving torque, viscous friction (implicit) and Coulomb friction that sticks."""
    direction = np.sign(np.where(speed == 0.0, push, speed))
    free = (inertia * speed + STEP * push) / (inertia + STEP * viscous)
    end = free - STEP * level * direction / (inertia + STEP * viscous)
    held = (end * direction <= 0.0) & (np.abs(push) <= level)
    # turned round within the step although the push is stronger than friction: it starts from rest
    turned = (end * direction < 0.0) & ~held
    restart = STEP * (push - level * np.sign(push)) / (inertia + STEP * viscous)
    return np.where(held, 0.0, np.where(turned, 0.5 * restart, end))


def nominal_load(kind: str) -> Load:
    """The bench of a joint kind, or the `rigid` one."""
    return Load(*LOADS[kind])
