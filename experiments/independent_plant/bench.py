"""A single revolute joint on a bench: on its series-elastic drive, or on a rigid one whose torque is logged.

The load obeys J ddq = torque - b dq - G sin q. Arrays stay (B, 12) so that the hidden effects of the robot serve
here too; a bench log keeps one column. On the rigid drive the gear is 1: an effect's numbers are the joint's.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.independent_plant.bench_bodies import LOADS, Load, stick_slip
from experiments.independent_plant.drive import STEP, Command
from experiments.independent_plant.hooks import hooked
from experiments.independent_plant.library import families_of
from experiments.independent_plant.log_setup import LogSetup, hanging
from experiments.independent_plant.motions import bench_course
from experiments.independent_plant.numbers import Array, DriveNumbers, nominal_drive
from experiments.independent_plant.plant import Recording, simulate
from experiments.independent_plant.sensors import Sensors

RIGID_PERIOD = 1e-3  # s
RIGID_KP, RIGID_KD = 60.0, 6.0  # N m/rad, N m s/rad of the rigid bench's own controller, per 0.3 kg m^2


def elastic_bench(
    setups: Sequence[LogSetup], loads: Sequence[Load], kinds: Sequence[str], duration: float, richness: Sequence[str]
) -> Recording:
    """Bench logs on the series-elastic drives of joint `kinds`; columns are the robot's joints LF_<kind>."""
    rngs = [np.random.default_rng([setup.seed, 0]) for setup in setups]
    courses = np.stack([bench_course(duration, kind, r, rng) for kind, r, rng in zip(kinds, richness, rngs)])
    start = hanging(np.tile(courses[:, :1], (1, 12)))
    still = np.full((len(setups), 12), np.nan)

    def controller(k: int, row: dict[str, Array]) -> Command:
        return Command(still, np.tile(courses[:, k, None], (1, 12)))

    return simulate("bench", setups, controller, start, duration, loads=loads)


@dataclass
class RigidDrive:
    """What the drive's hooks see of a rigid drive: gear 1, a current of 1 A per N m."""

    numbers: DriveNumbers
    motor_position: Array
    motor_velocity: Array
    gear: float = 1.0
    time: float = 0.0

    def __post_init__(self) -> None:
        self.mean_current = self.spring_torque = self.acceleration = np.zeros_like(self.motor_position)


def rigid_bench(
    setups: Sequence[LogSetup], loads: Sequence[Load], duration: float, richness: Sequence[str]
) -> Recording:
    """Bench logs on a rigid drive at 1 kHz; signals `joint_position` and `applied_torque`, all columns alike."""
    batch, rows = len(setups), round(duration / RIGID_PERIOD)
    rngs = [np.random.default_rng([setup.seed, 0]) for setup in setups]
    courses = np.stack([bench_course(duration, "rigid", r, rng, RIGID_PERIOD) for r, rng in zip(richness, rngs)])
    families = families_of([s.effects for s in setups], [np.random.default_rng([s.seed, 1]) for s in setups])
    numbers = nominal_drive(batch)
    inertia, viscous, gravity = (
        np.tile([[getattr(load, name)] for load in loads], (1, 12))
        for name in ("inertia", "viscous_friction", "gravity_load")
    )
    numbers.motor_inertia = inertia
    drive = RigidDrive(numbers, np.tile(courses[:, :1], (1, 12)), np.zeros((batch, 12)))
    for family in hooked(families, "attach"):
        family.attach(drive)
    sensors = Sensors(
        [s.sensors for s in setups],
        [np.random.default_rng([s.seed, 2]) for s in setups],
        rows,
        ["joint_position", "joint_velocity", "applied_torque"],
    )
    bench = _Rigid(drive, families, viscous, gravity, sensors)
    kept = [bench.row(k, courses[:, k, None]) for k in range(rows)]
    signals = {name: np.stack([row[name] for row in kept], axis=1) for name in ("joint_position", "applied_torque")}
    command = Command(np.full((batch, rows, 12), np.nan), np.tile(courses[..., None], (1, 1, 12)))
    return Recording(signals, command, {}, bench.power, bench.command_power, np.zeros(batch, dtype=bool))


class _Rigid:
    """The rigid bench's loop."""

    def __init__(self, drive: RigidDrive, families: list, viscous: Array, gravity: Array, sensors: Sensors) -> None:
        self.drive, self.families, self.viscous, self.gravity = drive, families, viscous, gravity
        self.sensors = sensors
        self.applied = np.zeros_like(viscous)
        self.power = {family.name: np.zeros_like(viscous) for family in families}
        self.command_power = np.zeros_like(viscous)
        self.before = self._signals()

    def _signals(self) -> dict[str, Array]:
        d = self.drive
        return {
            "joint_position": d.motor_position,
            "joint_velocity": d.motor_velocity,
            "applied_torque": self.applied,
        }

    def row(self, k: int, wanted: Array) -> dict[str, Array]:
        """Measure, control for 1 ms, and return what was measured and applied."""
        now, before = self._signals(), self.before
        for family in hooked(self.families, "measure"):
            joint = family.measure(self.drive.time, now | {"joint_torque": self.applied})
            now = {name: joint[name] for name in now}
            joint = family.measure(self.drive.time - STEP, before | {"joint_torque": self.applied})
            before = {name: joint[name] for name in before}
        scale = self.drive.numbers.motor_inertia / LOADS["rigid"][0]
        seen = self.sensors.row(k, now, before, STEP)
        self.applied = scale * (RIGID_KP * (wanted - seen["joint_position"]) - RIGID_KD * seen["joint_velocity"])
        noise = self.sensors.noise["applied_torque"][:, k]
        for family in self.families:
            if family.torque is not None:
                self.power[family.name] += np.square(family.torque)
        self.command_power += np.square(self.applied)
        for i in range(round(RIGID_PERIOD / STEP)):
            if i == round(RIGID_PERIOD / STEP) - 1:
                self.before = self._signals()
            self._step()
        for family in hooked(self.families, "remember"):
            family.remember(self.drive.time, self._signals())
        return seen | {"applied_torque": self.applied + noise}

    def _step(self) -> None:
        d = self.drive
        d.mean_current = d.spring_torque = torque = self.applied
        for family in hooked(self.families, "rotor_torque"):
            torque = family.rotor_torque(d, torque)
        for family in hooked(self.families, "link_torque"):
            torque = torque + family.link_torque(d.time, d.motor_position, d.motor_velocity)
        push = torque - self.gravity * np.sin(d.motor_position)
        direction = np.sign(np.where(d.motor_velocity == 0.0, push, d.motor_velocity))
        level, smooth = np.zeros_like(push), np.zeros_like(push)
        for family in hooked(self.families, "friction"):
            more_level, more_smooth = family.friction(d, d.motor_velocity, direction)
            level, smooth = level + more_level, smooth + more_smooth
        before = d.motor_velocity
        d.motor_velocity = stick_slip(
            before, push - smooth, np.maximum(level, 0.0), self.viscous, d.numbers.motor_inertia
        )
        d.motor_position = d.motor_position + 0.5 * STEP * (before + d.motor_velocity)
        d.acceleration = (d.motor_velocity - before) / STEP
        d.time += STEP
        for family in hooked(self.families, "commit"):
            family.commit(d)
