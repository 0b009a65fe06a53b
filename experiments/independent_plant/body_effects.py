"""Hidden effects on the bodies: drag and mass of the links, payload, ground, forces."""

from typing import ClassVar

import numpy as np

from experiments.independent_plant.bodies import Bodies, BodyChanges
from experiments.independent_plant.hooks import Family
from experiments.independent_plant.numbers import Array


class JointCoulombDrag(Family):
    name = "joint_coulomb_drag"
    about = "Coulomb friction between the links, on the load's side of the spring"
    units: ClassVar = {"level": "N m"}
    scaled = "level"

    def change_bodies(self, log: int, changes: BodyChanges) -> None:
        changes.coulomb_drag += self.level[log]

    def observe(self, bodies: Bodies) -> None:
        # MuJoCo applies it, as a constraint that sticks
        self.torque = self.level * np.sign(bodies.velocity)


class JointViscousDrag(Family):
    name = "joint_viscous_drag"
    about = "viscous friction between the links, on the load's side of the spring"
    units: ClassVar = {"coefficient": "N m s/rad"}
    scaled = "coefficient"

    def change_bodies(self, log: int, changes: BodyChanges) -> None:
        changes.viscous_drag += self.coefficient[log]

    def observe(self, bodies: Bodies) -> None:
        self.torque = self.coefficient * bodies.velocity


class LinkMass(Family):
    name = "link_mass"
    about = "more mass in the link below the joint, its inertia growing in proportion"
    units: ClassVar = {"added": "kg"}
    scaled = "added"

    def change_bodies(self, log: int, changes: BodyChanges) -> None:
        changes.added_link_mass += self.added[log]

    def observe(self, bodies: Bodies) -> None:
        if self.torque is None:
            self.torque = np.zeros_like(self.added)
            self.without = {
                int(i): bodies.lightened(int(i), self.added[i]) for i in np.flatnonzero(self.added.any(axis=1))
            }
        for log, model in self.without.items():
            self.torque[log] = bodies.inverse(log) - bodies.inverse(log, model)


class Placed(Family):
    """An effect with one value per log, not per joint."""

    def __init__(self, batch: int) -> None:
        for parameter in self.units:
            setattr(self, parameter, np.full(batch, self.neutral.get(parameter, 0.0)))
        self.active = np.zeros((batch, 12))

    def add(self, log: int, where: str, parameters: dict[str, float], rng: np.random.Generator) -> None:
        if where not in self.places:
            raise ValueError(f"{self.name} acts on {' or '.join(self.places)}, not on {where!r}")
        for parameter, value in self.checked(parameters).items():
            getattr(self, parameter)[log] = value
        self.active[log] = 1.0


class Payload(Placed):
    name = "payload"
    about = "a point mass fixed to the torso at x, y, z in its frame"
    units: ClassVar = {"mass": "kg", "x": "m", "y": "m", "z": "m"}
    places = ("torso",)
    scaled = "mass"

    def change_bodies(self, log: int, changes: BodyChanges) -> None:
        changes.payload_mass += self.mass[log]
        changes.payload_position = np.array([self.x[log], self.y[log], self.z[log]])


class GroundFriction(Placed):
    name = "ground_friction"
    about = "friction coefficient of the ground differs by `change`"
    units: ClassVar = {"change": "-"}
    places = ("feet",)
    scaled = "change"

    def change_bodies(self, log: int, changes: BodyChanges) -> None:
        changes.friction_change += self.change[log]


class GroundCompliance(Placed):
    name = "ground_compliance"
    about = "the ground yields below each foot along its normal, a spring of 1/compliance with a damper"
    units: ClassVar = {"compliance": "m/N", "damping": "N s/m"}
    neutral: ClassVar = {"damping": 100.0}
    places = ("feet",)
    scaled = "compliance"

    def change_bodies(self, log: int, changes: BodyChanges) -> None:
        changes.compliance += self.compliance[log]
        changes.compliance_damping = self.damping[log]


class GroundSlope(Placed):
    name = "ground_slope"
    about = "the ground rises by the angle x along the world's x axis and by y along its y axis"
    units: ClassVar = {"x": "rad", "y": "rad"}
    places = ("feet",)
    scaled = "x"

    def change_bodies(self, log: int, changes: BodyChanges) -> None:
        changes.slope_x += self.x[log]
        changes.slope_y += self.y[log]


class ConstantForce(Placed):
    name = "constant_force"
    about = "a steady force at the torso's origin, world frame"
    units: ClassVar = {"x": "N", "y": "N", "z": "N"}
    places = ("torso",)
    scaled = "x"

    def torso_force(self, time: float) -> Array:
        return np.stack([self.x, self.y, self.z], axis=-1)
