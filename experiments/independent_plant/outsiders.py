"""Effects that the diagnosis has no name for: what it meets here it should call unknown."""

from typing import ClassVar

import numpy as np

from experiments.independent_plant.bodies import BodyChanges
from experiments.independent_plant.body_effects import Placed
from experiments.independent_plant.drive import STEP, Drive
from experiments.independent_plant.hooks import Family
from experiments.independent_plant.numbers import MIRROR, Array, nominal_drive, numbers_file, per_kind

STANCE = MIRROR * per_kind(numbers_file()["default_stance"]["LF"])  # rad
RANDOM_TABLE = 40.0  # s, a random course longer than any log


def random_course(rng: np.random.Generator, corner: float, shape: tuple[int, ...], step: float) -> Array:
    """Gaussian noise below a corner frequency [Hz], unit RMS: (time, *shape) over RANDOM_TABLE at `step`."""
    white = rng.standard_normal((round(RANDOM_TABLE / step), *shape))
    frequency = np.fft.rfftfreq(len(white), step)
    spectrum = np.fft.rfft(white, axis=0) * (frequency < corner).reshape(-1, *(1,) * len(shape))
    course = np.fft.irfft(spectrum, n=len(white), axis=0)
    return course / np.sqrt(np.mean(np.square(course)))


class ThermalFade(Family):
    name = "thermal_fade"
    about = "the torque constant fades by `fraction` (1 - exp(-t / time_constant)) as the magnets warm up"
    units: ClassVar = {"fraction": "-", "time_constant": "s"}
    neutral: ClassVar = {"time_constant": 3.0}
    scaled = "fraction"
    library = False

    def rotor_torque(self, drive: Drive, torque: Array) -> Array:
        less = self.fraction * (1.0 - np.exp(-drive.time / self.time_constant)) * torque
        self.torque = drive.gear * less
        return torque - less


class WarmCogging(Family):
    name = "warm_cogging"
    about = "cogging locked to the gear's output, amplitude exp(-t / time_constant) sin(harmonic x gear angle)"
    units: ClassVar = {"amplitude": "N m", "harmonic": "1/rev", "time_constant": "s"}
    neutral: ClassVar = {"harmonic": 37.0, "time_constant": 6.0}
    scaled = "amplitude"
    library = False

    def rotor_torque(self, drive: Drive, torque: Array) -> Array:
        more = self.amplitude * np.exp(-drive.time / self.time_constant)
        more = more * np.sin(self.harmonic * drive.motor_position)
        self.torque = drive.gear * more
        return torque + more


class DriveDropout(Family):
    name = "drive_dropout"
    about = "a loose contact: the motor's torque is gone for `duration`, `rate` times a second at random"
    units: ClassVar = {"rate": "1/s", "duration": "s"}
    neutral: ClassVar = {"duration": 0.03}
    scaled = "rate"
    library = False

    def __init__(self, batch: int) -> None:
        super().__init__(batch)
        self.gone: list[list[Array]] = [[np.zeros((0, 2))] * 12 for _ in range(batch)]

    def add(self, log: int, where: str, parameters: dict[str, float], rng: np.random.Generator) -> None:
        super().add(log, where, parameters, rng)
        self.table = getattr(self, "table", np.zeros((round(RANDOM_TABLE / 1e-3), *self.rate.shape), dtype=bool))
        for joint in np.flatnonzero(self.active[log]):
            starts = np.flatnonzero(rng.random(len(self.table)) < 1e-3 * self.rate[log, joint])
            for start in starts:
                self.table[start : start + round(1e3 * self.duration[log, joint]), log, joint] = True

    def rotor_torque(self, drive: Drive, torque: Array) -> Array:
        gone = self.table[int(drive.time * 1e3 + 1e-6)]
        self.torque = np.where(gone, drive.gear * torque, 0.0)
        return np.where(gone, 0.0, torque)


class WarmupFriction(Family):
    name = "warmup_friction"
    about = "viscous friction of cold grease: coefficient exp(-t / time_constant) at the rotor"
    units: ClassVar = {"coefficient": "N m s/rad", "time_constant": "s"}
    neutral: ClassVar = {"time_constant": 2.0}
    scaled = "coefficient"
    library = False

    def friction(self, drive: Drive, speed: Array, direction: Array) -> tuple[float, Array]:
        more = self.coefficient * np.exp(-drive.time / self.time_constant) * speed
        self.torque = drive.gear * more
        return 0.0, more


class FlexibleLink(Family):
    name = "flexible_link"
    about = "a mass on a flexure below the joint: inertia, resonance and damping ratio of the oscillator"
    units: ClassVar = {"inertia": "kg m^2", "frequency": "Hz", "damping_ratio": "-"}
    neutral: ClassVar = {"frequency": 12.0, "damping_ratio": 0.03}
    scaled = "inertia"
    library = False

    def __init__(self, batch: int) -> None:
        super().__init__(batch)
        self.bend, self.bend_rate = np.zeros((batch, 12)), np.zeros((batch, 12))
        self.before: Array | None = None

    def link_torque(self, time: float, position: Array, velocity: Array) -> Array:
        if self.before is None:
            self.before = velocity.copy()
        w = 2.0 * np.pi * self.frequency
        # the flexure's angle against the link, driven by the link's own change of speed
        self.bend_rate = self.bend_rate - (velocity - self.before)
        self.bend_rate = self.bend_rate - STEP * (w**2 * self.bend + 2.0 * self.damping_ratio * w * self.bend_rate)
        self.bend = self.bend + STEP * self.bend_rate
        self.before = velocity.copy()
        self.torque = self.inertia * (w**2 * self.bend + 2.0 * self.damping_ratio * w * self.bend_rate)
        return self.torque


class CableSpring(Family):
    name = "cable_spring"
    about = "a cable to the torso that hardens: -stiffness (x + hardening x^3), x the angle from the stance + `rest`"
    units: ClassVar = {"stiffness": "N m/rad", "hardening": "1/rad^2", "rest": "rad"}
    neutral: ClassVar = {"hardening": 4.0}
    scaled = "stiffness"
    library = False

    def link_torque(self, time: float, position: Array, velocity: Array) -> Array:
        x = position - STANCE - self.rest
        self.torque = -self.stiffness * (x + self.hardening * x**3)
        return self.torque


class JointDraft(Family):
    name = "joint_draft"
    about = "a random torque on the link below a corner frequency, as of a hose dragged along"
    units: ClassVar = {"torque_rms": "N m", "corner": "Hz"}
    neutral: ClassVar = {"corner": 1.0}
    scaled = "torque_rms"
    library = False

    def add(self, log: int, where: str, parameters: dict[str, float], rng: np.random.Generator) -> None:
        super().add(log, where, parameters, rng)
        self.table = getattr(self, "table", np.zeros((round(RANDOM_TABLE / 0.01), *self.corner.shape)))
        self.table[:, log] = random_course(rng, self.checked(parameters)["corner"], (12,), 0.01)

    def link_torque(self, time: float, position: Array, velocity: Array) -> Array:
        row = time / 0.01
        share = row - int(row)
        course = (1.0 - share) * self.table[int(row)] + share * self.table[int(row) + 1]
        self.torque = self.torque_rms * course
        return self.torque


class Vibration(Family):
    name = "vibration"
    about = "a shaker on the link: amplitude sin(2 pi frequency t)"
    units: ClassVar = {"amplitude": "N m", "frequency": "Hz"}
    neutral: ClassVar = {"frequency": 9.0}
    scaled = "amplitude"
    library = False

    def link_torque(self, time: float, position: Array, velocity: Array) -> Array:
        self.torque = self.amplitude * np.sin(2.0 * np.pi * self.frequency * time)
        return self.torque


class EncoderEccentricity(Family):
    name = "encoder_eccentricity"
    about = "the joint encoder's disc sits off its axis: + amplitude sin(harmonic x angle + phase)"
    units: ClassVar = {"amplitude": "rad", "harmonic": "1/rev", "phase": "rad"}
    neutral: ClassVar = {"harmonic": 11.0}
    scaled = "amplitude"
    library = False

    def __init__(self, batch: int) -> None:
        super().__init__(batch)
        self.stiffness = nominal_drive(batch).spring_stiffness

    def measure(self, time: float, signals: dict[str, Array]) -> dict[str, Array]:
        angle = self.harmonic * signals["joint_position"] + self.phase
        error = self.amplitude * np.sin(angle)
        rate = self.amplitude * self.harmonic * np.cos(angle) * signals["joint_velocity"]
        self.torque = self.stiffness * error
        return signals | {
            "joint_position": signals["joint_position"] + error,
            "joint_velocity": signals["joint_velocity"] + rate,
        }


class Sloshing(Placed):
    name = "sloshing"
    about = "a liquid on the torso as a pendulum that swings in x and y"
    units: ClassVar = {"mass": "kg", "length": "m", "damping": "N m s/rad"}
    neutral: ClassVar = {"length": 0.1, "damping": 0.02}
    places = ("torso",)
    scaled = "mass"
    library = False

    def change_bodies(self, log: int, changes: BodyChanges) -> None:
        changes.pendulum_mass += self.mass[log]
        changes.pendulum_length = self.length[log]
        changes.pendulum_damping = self.damping[log]


class Wind(Placed):
    name = "wind"
    about = "a random horizontal and vertical force on the torso below a corner frequency"
    units: ClassVar = {"force_rms": "N", "corner": "Hz"}
    neutral: ClassVar = {"corner": 0.7}
    places = ("torso",)
    scaled = "force_rms"
    library = False

    def add(self, log: int, where: str, parameters: dict[str, float], rng: np.random.Generator) -> None:
        super().add(log, where, parameters, rng)
        self.table = getattr(self, "table", np.zeros((round(RANDOM_TABLE / 0.0025), *self.corner.shape, 3)))
        self.table[:, log] = random_course(rng, self.checked(parameters)["corner"], (3,), 0.0025)

    def torso_force(self, time: float) -> Array:
        return self.force_rms[:, None] * self.table[round(time / 0.0025)]
