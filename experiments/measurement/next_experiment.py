"""Which motion would tell tied effects apart? Each candidate is played on both models, as both fitted the log."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controller_jax.geometry import geometry_from_numbers
from experiments.files import write_text
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.drive_log import DriveLog
from experiments.measurement.evidence.drive_replay import true_motion
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.excitation import Excitation, excitations
from experiments.measurement.fits.fit_types import Placed, Refitted
from experiments.measurement.selection.ladder import Selection
from experiments.model import Model
from sea_jax import JointMotion

STEP = 0.02  # of a parameter: to see what the rival could still adapt
FROM_STOPS = 0.3  # rad that the middle of a motion stays away from the joints' ends
TELLS = 1.0  # noise deviations from which a motion tells two effects apart


@dataclass(frozen=True)
class NextExperiment:
    """Commands (T, J) for the legs in the air, and how many noise deviations they put between the rivals."""

    text: str
    excitation: Excitation | None = None


def next_experiment(logs: Sequence[Evidence], selection: Selection, model: Model) -> NextExperiment:
    """The motion that separates the effects still tied; without ties, none."""
    rivals = [(fit, rival) for fit, rivals in zip(selection.winners, selection.rivals, strict=True) for rival in rivals]
    if not rivals:
        return NextExperiment("")
    log = next((log for log in logs if log.drive is not None), None)
    names = sorted({f"{p.effect}@{p.where}" for pair in rivals for p in (pair[0].effects[-1], pair[1].effects[-1])})
    tied = " and ".join(names)
    if log is None or model.numbers is None:
        return NextExperiment(f"move through all speeds, loads and reversals: this motion cannot tell {tied} apart")
    geometry = geometry_from_numbers(model.numbers.model_dump(mode="json"))
    rest = log.drive.log.joint_position[: log.drive.rows].mean(0).astype(float)
    limits = np.asarray(geometry.position_limits, float)
    rest = np.clip(rest, limits[:, 0] + FROM_STOPS, limits[:, 1] - FROM_STOPS)
    judged = []
    for excitation in excitations(limits, rest, log.period):
        judged.append((min(separation(log, *pair, excitation) for pair in rivals), excitation))
    size, best = max(judged, key=lambda pair: pair[0])
    if size < TELLS:
        text = f"no motion of the legs in the air tells {tied} apart; load the legs: squat and hop on the ground"
        return NextExperiment(text)
    text = f"legs in the air, {best.name}: it puts {size:.1f} noise deviations between {tied}; play next_experiment.csv"
    return NextExperiment(text, best)


def separation(log: Evidence, winner: Refitted, rival: Refitted, excitation: Excitation) -> float:
    """RMS over noise of what the rival cannot imitate, in the joint and channel where that is largest."""
    rows = _commanded(excitation, log.period)
    motion = true_motion(rows, log.period, {})
    base, columns = _points(log.atoms, log.model_x, winner.effects, rival.effects)
    shown = _play(log, rows, motion, np.stack([base, *columns]))
    over = shown / log.drive.floor[None, None]
    gap, adapt = over[0] - over[1], over[2:] - over[1]
    flat = adapt.reshape(len(adapt), -1).T
    if flat.size:
        solution, *_ = np.linalg.lstsq(flat, gap.ravel(), rcond=None)
        gap = gap - (flat @ solution).reshape(gap.shape)
    return float(np.sqrt((gap**2).mean(0)).max())


def _points(atoms: Atoms, x: np.ndarray, winner: Sequence[Placed], rival: Sequence[Placed]):
    """x of the winner; x of the rival, and of the rival with each of its parameters moved."""
    moved = [atoms.placed(x, rival)]
    for i, placed in enumerate(rival):
        for name, value in placed.parameters.items():
            other = placed.parameters | {name: value + STEP * (abs(value) or 1.0)}
            moved.append(atoms.placed(x, [*rival[:i], placed._replace(parameters=other), *rival[i + 1 :]]))
    return atoms.placed(x, winner), moved


def _play(log: Evidence, rows: DriveLog, motion: JointMotion, xs: np.ndarray) -> np.ndarray:
    shifts = np.zeros((len(xs), len(log.atoms.joint_names)))
    return log.drive.play(rows, motion, xs, shifts)


def _commanded(excitation: Excitation, period: float) -> DriveLog:
    """The motion as if the joints followed it."""
    q = np.float32(excitation.position)
    v = np.float32(np.gradient(excitation.position, period, axis=0))
    zero = np.zeros_like(q)
    return DriveLog(
        command_torque=zero,
        command_position=q,
        position_mode=np.ones_like(q),
        joint_position=q,
        joint_velocity=v,
        joint_torque=zero,
        motor_position=q,
        motor_velocity=v,
        motor_current=zero,
    )


def write_commands(path: Path, excitation: Excitation, joints: Sequence[str], period: float) -> None:
    """The command file: one row a control tick, `time` and `command_position/<joint>`; an empty cell is no command."""
    header = ",".join(["time", *(f"command_position/{name}" for name in joints)])
    time = np.arange(len(excitation.position)) * period
    rows = (",".join(f"{x:.6f}" for x in (t, *row)) for t, row in zip(time, excitation.position, strict=True))
    write_text(path, "\n".join([header, *rows]) + "\n")
