"""Recordings of one trial: from the rollout's ticks to arrays for reports, and to a file to replay the motion."""

import io
from pathlib import Path

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from experiments.errors import UserError
from experiments.files import write_bytes
from experiments.reports.recording import JUMP_PHASES, GaitRecord, JumpRecord, Recording
from experiments.rollout import Tick


def until_divergence(ticks: Tick) -> Tick:
    """The ticks (NumPy leaves) before the rollout diverges, or all. Raises UserError for less than two."""
    alive = int(np.asarray(ticks.alive).sum())
    if alive < 2:
        raise UserError("The motion diverges from the first moment on: there is nothing to show.")
    return jax.tree.map(lambda x: x[:alive], ticks)


def jump_record(ticks: Tick, drive: str) -> JumpRecord:
    """The ticks of a squat jump as the report shows them; states are those at the end of each tick.

    A motion that diverges is shown up to there. Raises UserError where nothing is left.
    """
    ticks = until_divergence(ticks)
    phase = np.asarray(ticks.info.phase).round().astype(int)
    landing, standing = JUMP_PHASES.index("landing"), JUMP_PHASES.index("standing")
    phase = np.where((phase == landing) & (np.asarray(ticks.info.settled) > 0), standing, phase)
    desired_height = np.asarray(ticks.info.desired_height)
    return JumpRecord(drive=drive, **_signals(ticks), desired_height=desired_height, phase=phase)


def gait_record(ticks: Tick, drive: str) -> GaitRecord:
    """The ticks of a gait, as in `jump_record`."""
    ticks = until_divergence(ticks)
    info, u = ticks.info, np.asarray(ticks.after.bodies.u)
    normal = np.asarray(info.plane.normal_W)
    R_WB, seen = _rotations(np.asarray(ticks.after.bodies.q)[:, 3:7]), ticks.robot
    omega_W = np.einsum("tij,tj->ti", R_WB, u[:, 3:6])
    seen_omega_W = np.einsum("tij,tj->ti", seen.R_WB, seen.omega_B)
    cycle = np.asarray(info.phase)
    return GaitRecord(
        drive=drive,
        **_signals(ticks),
        desired_height=np.asarray(info.torso.r_WB)[:, 2] + _drift(ticks),
        phase=np.concatenate([[0], np.cumsum(np.diff(cycle) < 0)]) + np.maximum.accumulate(cycle > 0),
        planned_stance=np.asarray(info.planned_stance),
        command=np.stack([np.asarray(c) for c in info.command], 1),
        velocity=_in_control_frame(R_WB, normal, u[:, :3], omega_W),
        estimated_velocity=_in_control_frame(np.asarray(seen.R_WB), normal, np.asarray(seen.v_WB), seen_omega_W),
        pitch=-np.arcsin(np.clip(R_WB[:, 2, 0], -1.0, 1.0)),
        desired_pitch=-np.arcsin(np.clip(np.asarray(info.torso.R_WB)[:, 2, 0], -1.0, 1.0)),
    )


def _drift(ticks: Tick) -> np.ndarray:
    """How much higher the torso is than the controller believes (T,), m: its estimate of position drifts."""
    return np.asarray(ticks.before.bodies.q)[:, 2] - np.asarray(ticks.robot.r_WB)[:, 2]


def _in_control_frame(R_WB: np.ndarray, normal: np.ndarray, v_W: np.ndarray, omega_W: np.ndarray) -> np.ndarray:
    """Speed along the heading, to the left, and turning (T, 3) on a ground with normals (T, 3)."""
    x = R_WB[:, :, 0] - normal * (R_WB[:, :, 0] * normal).sum(1, keepdims=True)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([(v_W * x).sum(1), (v_W * np.cross(normal, x)).sum(1), (omega_W * normal).sum(1)], 1)


def _rotations(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices (T, 3, 3), torso to world, of quaternions w x y z (T, 4)."""
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def _signals(ticks: Tick) -> dict[str, np.ndarray]:
    """What every recording has."""
    after, drive, bodies = ticks.after, ticks.output.drive, ticks.output.bodies
    found = {
        "time": np.asarray(ticks.time, float),
        "q": after.bodies.q,
        "u": after.bodies.u,
        "foot_position": bodies.r_WF,
        "contact_force": bodies.contact_force,
        "joint_torque": drive.torque,
        "wanted_velocity": drive.wanted_velocity,
        "commanded_velocity": drive.commanded_velocity,
        "motor_velocity": after.drive.motor_velocity,
        "current": drive.peak_current,
        "voltage": drive.peak_voltage,
    }
    return {name: np.asarray(value) for name, value in found.items()}


def write_motion(path: Path, record: Recording) -> None:
    """The motion as compressed NumPy arrays by name (no pickle), written atomically."""
    buffer = io.BytesIO()
    arrays = {name: value for name, value in vars(record).items() if isinstance(value, np.ndarray)}
    np.savez_compressed(buffer, drive=np.array(record.drive), **arrays)
    write_bytes(path, buffer.getvalue())
