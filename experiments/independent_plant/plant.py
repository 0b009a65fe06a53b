"""The whole robot measured: drives, bodies and sensors of a batch of logs, stepped side by side at 10 kHz.

Every 2.5 ms a row is measured, the controller turns it into a command, and the joint controllers act on the
same row; the row is what the log keeps. Logs of a batch share the experiment and its length, nothing else.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.independent_plant import leg_geometry
from experiments.independent_plant.bench_bodies import BenchBodies, Load
from experiments.independent_plant.bodies import Bodies, model_text
from experiments.independent_plant.drive import (
    CONTROL_STEPS,
    STEP,
    Command,
    Drive,
    JointController,
    Measured,
)
from experiments.independent_plant.hooks import hooked
from experiments.independent_plant.library import families_of
from experiments.independent_plant.log_setup import LogSetup, Start, changes_of
from experiments.independent_plant.numbers import (
    UNCERTAIN,
    Array,
    nominal_drive,
    numbers_file,
    per_kind,
)
from experiments.independent_plant.sensors import Sensors

PERIOD = CONTROL_STEPS * STEP  # s, of the rows
LOAD_STEPS = 10  # the bearings' radial load is taken anew every 1 ms
ACCELEROMETER_STEPS = 5  # and the accelerometer averages over 0.5 ms
DRAG_SPEED = 0.02  # rad/s over which the bearings' small friction turns its sign
Controller = Callable[[int, dict[str, Array]], Command]


@dataclass
class Recording:
    """Measured rows and commands (B, T, n), and what only the judge may see."""

    signals: dict[str, Array]
    command: Command
    true: dict[str, Array]  # signals before the sensors
    power: dict[str, Array]  # effect -> (B, 12) summed squares of its torque, where it is one
    command_power: Array  # (B, 12) summed squares of the commanded torque
    fallen: Array  # (B,) bool


class Plant:
    """A batch of robots, ready to be stepped tick by tick."""

    def __init__(
        self,
        experiment: str,
        setups: Sequence[LogSetup],
        start: Start,
        rows: int,
        loads: Sequence[Load] | None = None,
    ) -> None:
        if experiment not in ("fixed_base", "ground", "bench"):
            raise ValueError(f"experiment is fixed_base, ground or bench, not {experiment!r}")
        self.free = experiment == "ground"
        self.setups = setups
        rngs = [np.random.default_rng([setup.seed, 1]) for setup in setups]
        self.families = families_of([s.effects for s in setups], rngs)
        changes = changes_of(setups, self.families)
        if loads is None:
            self.bodies = Bodies([model_text(experiment, s.bodies, c) for s, c in zip(setups, changes)])
        else:
            self.bodies = BenchBodies(loads, changes)
        self.bodies.place(start.joint_position, start.torso_position, start.torso_orientation)
        numbers = nominal_drive(len(setups))
        for name in UNCERTAIN:
            factors = np.array(
                [per_kind(dict(zip(("HAA", "HFE", "KFE"), s.off.get(name, (1.0,) * 3)))) for s in setups]
            )
            setattr(numbers, name, getattr(numbers, name) * factors)
        self.drive = Drive(numbers, self.families, np.array([[s.velocity_phase] for s in setups]))
        self.drive.start(start.joint_position, start.spring_torque)
        self.controller = JointController()
        self.contact_force = numbers_file()["contact"]["contact_flag_force"]
        self.bearing_load = np.zeros_like(self.drive.current)
        self._torso_speed = np.zeros((len(setups), 3))
        self.before = self.now = self._signals()
        sensor_rngs = [np.random.default_rng([setup.seed, 2]) for setup in setups]
        names = [name for name in self.now if name != "foot_force"]
        self.sensors = Sensors([s.sensors for s in setups], sensor_rngs, rows, names)
        self.k, self.rows = 0, rows
        self.forget_strength()
        self.fallen = np.zeros(len(setups), dtype=bool)

    def forget_strength(self) -> None:
        """Begin anew to sum up the squared torques of the effects and of the commands."""
        shape = self.drive.current.shape
        self.power = {family.name: np.zeros(shape) for family in self.families}
        self.command_power = np.zeros(shape)

    def _signals(self) -> dict[str, Array]:
        """What perfect sensors would read."""
        signals = {
            "joint_position": self.bodies.position,
            "joint_velocity": self.bodies.velocity,
            "motor_position": self.drive.motor_position,
            "motor_velocity": self.drive.motor_velocity,
            "joint_torque": self.drive.spring(
                self.drive.motor_position - self.bodies.position,
                self.drive.motor_velocity - self.bodies.velocity,
            ),
            "motor_current": self.drive.current,
        }
        if self.free:
            position, orientation = self.bodies.torso_pose()
            velocity, omega = self.bodies.torso_velocity()
            apart = ACCELEROMETER_STEPS * STEP
            felt = (velocity - self._torso_speed) / apart + np.array([0.0, 0.0, leg_geometry.GRAVITY])
            R = leg_geometry.rotation(orientation)
            signals |= {
                "base_position": position,
                "base_orientation": orientation,
                "base_linear_velocity": velocity,
                "base_angular_velocity": omega,
                "base_acceleration": np.einsum("bji,bj->bi", R, felt),
                "foot_force": self.bodies.foot_force(),
            }
        return signals

    def measure(self) -> dict[str, Array]:
        """The row of this tick."""
        now, before = dict(self.now), dict(self.before)
        for family in hooked(self.families, "measure"):
            now, before = family.measure(self.drive.time, now), family.measure(self.drive.time - STEP, before)
        row = self.sensors.row(self.k, now, before, STEP)
        if self.free:
            row["foot_contact"] = (now["foot_force"] >= self.contact_force).astype(float)
        return row

    def tick(self, row: dict[str, Array], command: Command) -> None:
        """2.5 ms under a command, the joint controllers acting on the measured row."""
        drive, bodies, time = self.drive, self.bodies, self.drive.time
        self._account(command)
        for family in hooked(self.families, "command"):
            command = family.command(time, command)
        seen = Measured(row["joint_position"], row["joint_velocity"], row["joint_torque"], row["motor_position"])
        drive.wanted_velocity = self.controller(command, seen)
        forces = [family.torso_force(time) for family in hooked(self.families, "torso_force")]
        if forces:
            bodies.push(sum(forces))
        link_families, memories = hooked(self.families, "link_torque"), hooked(self.families, "remember")
        for i in range(CONTROL_STEPS):
            if i % LOAD_STEPS == 0:
                self.bearing_load = drive.numbers.bearing_radius * bodies.radial_load()
            torque = drive.step(bodies.position, bodies.velocity)
            torque = torque - self.bearing_load * np.tanh(bodies.velocity / DRAG_SPEED)
            for family in link_families:
                torque = torque + family.link_torque(drive.time, bodies.position, bodies.velocity)
            if i == CONTROL_STEPS - ACCELEROMETER_STEPS and self.free:
                self._torso_speed = bodies.torso_velocity()[0]
            bodies.step(torque)
            if i == CONTROL_STEPS - 2:
                self.before = self._signals()
            if memories and i % 5 == 4:
                for family in memories:
                    family.remember(drive.time, self._signals())
        self.now = self._signals()
        self.fallen |= bodies.fallen()
        self.k += 1

    def _account(self, command: Command) -> None:
        """Sum up squared torques: of every effect, and of what is commanded."""
        for family in hooked(self.families, "observe"):
            family.observe(self.bodies)
        for family in self.families:
            if family.torque is not None:
                self.power[family.name] += np.square(family.torque)
        motor = self.drive.gear * self.drive.numbers.torque_constant * self.drive.wanted_current
        self.command_power += np.square(np.where(np.isnan(command.position), command.torque, motor))


def simulate(
    experiment: str,
    setups: Sequence[LogSetup],
    controller: Controller,
    start: Start,
    duration: float,
    settle: float = 0.0,
    loads: Sequence[Load] | None = None,
) -> Recording:
    """Run a batch for `duration` s after `settle` s under the controller's first command.

    `controller(k, row)` sees the measured row k, (B, n) arrays, and returns the Command held until the next.
    """
    early = round(settle / PERIOD)
    plant = Plant(experiment, setups, start, round(duration / PERIOD) + early, loads)
    return run(plant, controller, early)


def run(plant: Plant, controller: Controller, early: int = 0) -> Recording:
    """Step a new plant through all its rows; the first `early` of them are not kept."""
    rows: list[dict[str, Array]] = []
    commands: list[Command] = []
    true: list[dict[str, Array]] = []
    for k in range(-early, plant.rows - early):
        if k == 0:
            plant.forget_strength()
        row = plant.measure()
        command = controller(max(k, 0), row)
        if k >= 0:
            rows.append(row)
            commands.append(command)
            true.append(plant.now)
        plant.tick(row, command)
    return Recording(
        _stacked(rows),
        Command(*(np.stack([getattr(c, name) for c in commands], axis=1) for name in ("torque", "position"))),
        _stacked(true),
        {family.name: plant.power[family.name] for family in plant.families if family.torque is not None},
        plant.command_power,
        plant.fallen,
    )


def _stacked(rows: list[dict[str, Array]]) -> dict[str, Array]:
    return {name: np.stack([row[name] for row in rows], axis=1) for name in rows[0]}
