"""Hidden effects in the drive train: friction, motor, supply, play and spring. Units and places in each class."""

from typing import ClassVar

import numpy as np

from experiments.independent_plant.drive import Drive
from experiments.independent_plant.hooks import Family
from experiments.independent_plant.numbers import Array


class CoulombFriction(Family):
    name = "coulomb_friction"
    about = "more Coulomb friction at the rotor"
    units: ClassVar = {"level": "N m"}
    scaled = "level"

    def friction(self, drive: Drive, speed: Array, direction: Array) -> tuple[Array, float]:
        self.torque = drive.gear * self.level * np.sign(speed)
        return self.level, 0.0


class ViscousFriction(Family):
    name = "viscous_friction"
    about = "more viscous friction at the rotor"
    units: ClassVar = {"coefficient": "N m s/rad"}
    scaled = "coefficient"

    def friction(self, drive: Drive, speed: Array, direction: Array) -> tuple[float, Array]:
        more = self.coefficient * speed
        self.torque = drive.gear * more
        return 0.0, more


class CubicFriction(Family):
    name = "cubic_friction"
    about = "friction at the rotor that grows with the cube of its speed"
    units: ClassVar = {"coefficient": "N m s^3/rad^3"}
    scaled = "coefficient"

    def friction(self, drive: Drive, speed: Array, direction: Array) -> tuple[float, Array]:
        more = self.coefficient * speed**3
        self.torque = drive.gear * more
        return 0.0, more


class StribeckFriction(Family):
    name = "stribeck_friction"
    about = "breakaway above the Coulomb level: level exp(-(w / velocity)^2), w the rotor's speed"
    units: ClassVar = {"level": "N m", "velocity": "rad/s"}
    neutral: ClassVar = {"velocity": 20.0}
    scaled = "level"

    def friction(self, drive: Drive, speed: Array, direction: Array) -> tuple[Array, float]:
        more = self.level * np.exp(-np.square(speed / self.velocity))
        self.torque = drive.gear * more
        return more, 0.0


class LoadFriction(Family):
    name = "load_friction"
    about = "Coulomb friction in proportion to the joint torque, both on the joint side"
    units: ClassVar = {"coefficient": "-"}
    scaled = "coefficient"

    def friction(self, drive: Drive, speed: Array, direction: Array) -> tuple[Array, float]:
        more = self.coefficient * np.abs(drive.spring_torque)
        self.torque = more * np.sign(speed)
        return more / drive.gear, 0.0


class DirectionDependentFriction(Family):
    name = "direction_dependent_friction"
    about = "Coulomb level higher by `difference` turning forward and lower by it turning back, at the rotor"
    units: ClassVar = {"difference": "N m"}
    scaled = "difference"

    def friction(self, drive: Drive, speed: Array, direction: Array) -> tuple[Array, float]:
        more = self.difference * direction
        self.torque = drive.gear * self.difference * (speed != 0.0)
        return more, 0.0


class MotorInertia(Family):
    name = "motor_inertia"
    about = "more inertia at the rotor"
    units: ClassVar = {"added": "kg m^2"}
    scaled = "added"

    def attach(self, drive: Drive) -> None:
        drive.numbers.motor_inertia = drive.numbers.motor_inertia + self.added

    def commit(self, drive: Drive) -> None:
        self.torque = drive.gear**2 * self.added * drive.acceleration


class TorqueConstant(Family):
    name = "torque_constant"
    about = "torque per ampere differs by `change`; the back-EMF stays"
    units: ClassVar = {"change": "-"}
    scaled = "change"

    def rotor_torque(self, drive: Drive, torque: Array) -> Array:
        more = self.change * torque
        self.torque = drive.gear * more
        return torque + more


class TorqueConstantSaturation(Family):
    name = "torque_constant_saturation"
    about = "torque constant K / (1 + coefficient I^2)"
    units: ClassVar = {"coefficient": "1/A^2"}
    scaled = "coefficient"

    def rotor_torque(self, drive: Drive, torque: Array) -> Array:
        less = torque / (1.0 + self.coefficient * np.square(drive.mean_current))
        self.torque = drive.gear * (less - torque)
        return less


class TorqueRipple(Family):
    name = "torque_ripple"
    about = "amplitude sin(harmonic x rotor angle + phase) at the rotor"
    units: ClassVar = {"amplitude": "N m", "harmonic": "1/rev", "phase": "rad"}
    neutral: ClassVar = {"harmonic": 2.0}
    scaled = "amplitude"

    def rotor_torque(self, drive: Drive, torque: Array) -> Array:
        more = self.amplitude * np.sin(self.harmonic * drive.gear * drive.motor_position + self.phase)
        self.torque = drive.gear * more
        return torque + more


class BusVoltageSag(Family):
    name = "bus_voltage_sag"
    about = "the bus falls by `resistance` times the current that all motors draw from it (none is fed back)"
    units: ClassVar = {"resistance": "Ohm"}
    scaled = "resistance"

    def supply(self, drive: Drive, voltage: Array) -> Array:
        power = np.maximum((drive.voltage * drive.current).sum(axis=1, keepdims=True), 0.0)
        # V = V0 - R P/V; where the battery cannot give the power at all, half of V0 is the most it can do.
        root = np.sqrt(np.maximum(np.square(voltage) - 4.0 * self.resistance * power, 0.0))
        sagged = np.where(self.resistance > 0.0, 0.5 * (voltage + root), voltage)
        lost = np.maximum(np.abs(drive.voltage_wanted) - sagged, 0.0) - np.maximum(
            np.abs(drive.voltage_wanted) - voltage, 0.0
        )
        n = drive.numbers
        self.torque = drive.gear * n.torque_constant * lost / n.resistance
        return sagged


class Backlash(Family):
    name = "backlash"
    about = "play of +-half_width between motor and spring"
    units: ClassVar = {"half_width": "rad"}
    scaled = "half_width"

    def deflection(self, drive: Drive, deflection: Array) -> Array:
        inside = np.clip(deflection, -self.half_width, self.half_width)
        pulls = drive.pulls(deflection)
        stiffness = np.where(pulls, drive.numbers.spring_stiffness, drive.numbers.stop_stiffness)
        self.torque = -stiffness * inside
        return deflection - inside


class SpringStiffness(Family):
    name = "spring_stiffness"
    about = "spring stiffer by the fraction `change`; the knee's stop stays"
    units: ClassVar = {"change": "-"}
    scaled = "change"

    def attach(self, drive: Drive) -> None:
        n = drive.numbers
        self.difference = self.change * n.spring_stiffness
        n.spring_stiffness = n.spring_stiffness + self.difference

    def spring(self, drive: Drive, torque: Array, deflection: Array, rate: Array) -> Array:
        self.torque = np.where(drive.pulls(deflection), self.difference * deflection, 0.0)
        return torque


class SpringStiffening(Family):
    name = "spring_stiffening"
    about = "spring torque + coefficient d^3; the knee's stop stays"
    units: ClassVar = {"coefficient": "N m/rad^3"}
    scaled = "coefficient"

    def spring(self, drive: Drive, torque: Array, deflection: Array, rate: Array) -> Array:
        self.torque = np.where(drive.pulls(deflection), self.coefficient * deflection**3, 0.0)
        return torque + self.torque


class SpringDamping(Family):
    name = "spring_damping"
    about = "more viscous damping in parallel to the spring; the knee's stop stays"
    units: ClassVar = {"added": "N m s/rad"}
    scaled = "added"

    def spring(self, drive: Drive, torque: Array, deflection: Array, rate: Array) -> Array:
        self.torque = np.where(drive.pulls(deflection), self.added * rate, 0.0)
        return torque + self.torque


class SpringHysteresis(Family):
    name = "spring_hysteresis"
    about = "rate-independent hysteresis (Dahl): + level z, dz/dd = (1 - z sign(dd)) / width"
    units: ClassVar = {"level": "N m", "width": "rad"}
    neutral: ClassVar = {"width": 0.01}
    scaled = "level"

    def attach(self, drive: Drive) -> None:
        self.bristle = np.zeros_like(self.level)
        self.before = None

    def spring(self, drive: Drive, torque: Array, deflection: Array, rate: Array) -> Array:
        if self.before is None:
            self.before = deflection.copy()
        self.latest = deflection
        self.torque = self.level * self._bristle(deflection)
        return torque + self.torque

    def _bristle(self, deflection: Array) -> Array:
        # exact for a monotonic move: the bristle relaxes to the direction of motion over `width`
        move = deflection - self.before
        way = np.sign(move)
        return way + (self.bristle - way) * np.exp(-np.abs(move) / self.width)

    def commit(self, drive: Drive) -> None:
        self.bristle = np.where(self.active > 0.0, self._bristle(self.latest), 0.0)
        self.before = self.latest
