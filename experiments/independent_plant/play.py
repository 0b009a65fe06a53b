"""Use the second StarlETH as the robot: play a command file on it, or let a jump's controller drive it."""

import gzip
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.errors import UserError
from experiments.independent_plant.drive import Command
from experiments.independent_plant.leg_geometry import rotation, stance_angles
from experiments.independent_plant.library import Effect
from experiments.independent_plant.log_setup import LogSetup, Start, hanging, standing
from experiments.independent_plant.logs import columns, robot_info, write_log
from experiments.independent_plant.numbers import JOINT_NAMES, Array
from experiments.independent_plant.plant import PERIOD, Plant, Recording, run, simulate

LONGEST = 600.0  # s, of a command file
AIR_HEIGHT = 0.42  # m, the stance that legs in the air start from where no position is commanded


class State(NamedTuple):
    """What a locomotion controller sees; plain NumPy, one robot."""

    r_WB: Array  # (3,) m
    R_WB: Array  # (3, 3) torso to world
    v_WB: Array  # (3,) m/s, world
    omega_B: Array  # (3,) rad/s, torso frame
    q: Array  # (12,) rad
    qd: Array  # (12,) rad/s
    contact: Array  # (4,) 1.0 where a foot carries 10 N or more


class Targets(NamedTuple):
    """What it asks for; (12,) each."""

    torque: Array  # N m, used where position_mode is 0
    position: Array  # rad, used where position_mode is 1
    position_mode: Array  # 0.0 or 1.0


@dataclass(frozen=True)
class Jump:
    """What came of a jump: `true` signals by tick, (T, n) each, as logs name them, and `foot_force` (T, 4), N."""

    time: Array  # (T,) s
    true: dict[str, Array]
    fallen: bool
    recording: Recording  # the log of it

    @property
    def apex_height(self) -> float:
        """Highest torso origin, m."""
        return float(self.true["base_position"][:, 2].max())

    @property
    def flight_time(self) -> float:
        """Time without any foot on the ground, s."""
        return float((self.true["foot_force"].max(axis=1) <= 0.0).sum() * PERIOD)


def replay_jump(
    controller: Callable[[State, int], Targets],
    duration: float,
    effects: Sequence[Effect] = (),
    height: float = 0.42,
    start: Start | None = None,
    measured: bool = False,
    setup: LogSetup | None = None,
) -> Jump:
    """Let `controller(state, tick)` drive the robot on the ground at 400 Hz, hidden effects included.

    It starts at rest at `height` above the ground with its feet below the hips, or from `start`. The controller
    sees the true state, or the measured one; the joint controllers see what their sensors measure. `setup` gives the
    robot its own numbers and sensors; its effects then stand in for `effects`.
    """
    setup = setup or LogSetup(0, tuple(effects))
    plant = Plant("ground", [setup], start or standing([setup], height), round(duration / PERIOD))

    def command(tick: int, row: dict[str, Array]) -> Command:
        seen = row if measured else {**plant.now, "foot_contact": row["foot_contact"]}
        targets = controller(_state(seen), tick)
        by_position = np.asarray(targets.position_mode) > 0.5
        return Command(
            np.where(by_position, np.nan, np.asarray(targets.torque, dtype=float))[None],
            np.where(by_position, np.asarray(targets.position, dtype=float), np.nan)[None],
        )

    recording = run(plant, command)
    time = np.arange(plant.rows) * PERIOD
    return Jump(time, {name: values[0] for name, values in recording.true.items()}, bool(plant.fallen[0]), recording)


def _state(seen: dict[str, Array]) -> State:
    return State(
        seen["base_position"][0],
        rotation(seen["base_orientation"])[0],
        seen["base_linear_velocity"][0],
        seen["base_angular_velocity"][0],
        seen["joint_position"][0],
        seen["joint_velocity"][0],
        seen["foot_contact"][0],
    )


def read_command(path: Path) -> tuple[Array, Array]:
    """A command file (CSV or gzipped CSV: time, command_torque/<joint>, command_position/<joint>) at 400 Hz.

    Torques and positions (T, 12), NaN where a joint is in the other mode; rows are held between their times.
    Raises UserError for a file that is no such table.
    """
    path = Path(path)
    opened = gzip.open if path.suffix == ".gz" else open
    try:
        with opened(path, "rt") as file:
            names = file.readline().strip().split(",")
            lines = file.readlines()
            table = np.genfromtxt(lines, delimiter=",", ndmin=2) if lines else np.zeros((0, len(names)))
    except (OSError, EOFError, zlib.error, ValueError) as error:
        raise UserError(f"{path.name} cannot be read as a command table: {error}.") from None
    if "time" not in names or table.shape[1:] != (len(names),) or not len(table):
        raise UserError(f"{path.name} is no command table: it needs a column 'time' and as many cells as columns.")
    time = table[:, names.index("time")]
    if not np.isfinite(time).all() or (np.diff(time) <= 0.0).any():
        raise UserError(f"The times in {path.name} must be finite and increase from row to row.")
    if time[-1] - time[0] > LONGEST:
        raise UserError(f"{path.name} lasts {time[-1] - time[0]:g} s; play no more than {LONGEST:g} s at a time.")
    at = np.arange(round((time[-1] - time[0]) / PERIOD) + 1) * PERIOD + time[0]
    held = np.clip(np.searchsorted(time, at + 1e-9, side="right") - 1, 0, len(time) - 1)
    found = []
    for signal in ("command_torque", "command_position"):
        keys = [f"{signal}/{joint}" for joint in JOINT_NAMES]
        known = [table[:, names.index(key)] if key in names else np.full(len(time), np.nan) for key in keys]
        found.append(np.stack(known, axis=1)[held])
    torque, position = found
    if np.isinf(torque).any() or np.isinf(position).any():
        raise UserError(f"{path.name} commands something infinite; leave the cell empty where nothing is asked.")
    if np.isnan(torque).all() and np.isnan(position).all():
        raise UserError(f"{path.name} commands no joint of the robot.")
    return np.where(np.isnan(torque) & np.isnan(position), 0.0, torque), position


def refuse_broken(recording: Recording, fixed: bool) -> None:
    """Raise UserError where a robot alone, hung up or not, came to move as none can."""
    if (fixed and recording.fallen[0]) or not all(np.isfinite(values).all() for values in recording.true.values()):
        raise UserError("The robot's simulation breaks down with these commands and what is hidden: hide or ask less.")


def play_command(
    command_csv: Path,
    log: Path,
    effects: Sequence[Effect] = (),
    experiment: str = "fixed_base",
    seed: int = 0,
    setup: LogSetup | None = None,
) -> Recording:
    """Play a command file on the robot and write the log of it to `<log>.csv.gz` and `<log>.json`.

    `setup` gives the robot its own numbers and sensors; its effects and seed then stand in for those given.
    """
    torque, position = read_command(command_csv)
    setup = setup or LogSetup(seed, tuple(effects))
    first = np.where(np.isnan(position[0]), stance_angles(AIR_HEIGHT), position[0])
    start = hanging(first[None]) if experiment == "fixed_base" else standing([setup], AIR_HEIGHT)

    def controller(k: int, row: dict[str, Array]) -> Command:
        return Command(torque[k][None], position[k][None])

    recording = simulate(experiment, [setup], controller, start, len(torque) * PERIOD)
    refuse_broken(recording, fixed=experiment == "fixed_base")
    info = robot_info(experiment, setup.sensors, list(recording.signals))
    write_log(Path(log), columns(recording, 0), info)
    return recording
