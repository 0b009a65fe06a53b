"""Recordings of one trial: from the rollout's ticks to arrays for reports, and to a file to replay the motion."""

import io
from pathlib import Path

import numpy as np

from experiments.files import write_bytes
from experiments.reports.recording import JumpRecord
from experiments.rollout import Tick

STANDING_AFTER = 0.5  # s after touch-down, when the landing's height is reached (the controller's landing time)


def jump_record(ticks: Tick, drive: str) -> JumpRecord:
    """The ticks of a squat jump as the report shows them; states are those at the end of each tick."""
    host = lambda x: np.asarray(x)  # noqa: E731
    after, drive_output, bodies = ticks.after, ticks.output.drive, ticks.output.bodies
    phase = host(ticks.info.phase).round().astype(int)
    time = host(ticks.time).astype(float)
    landing = np.flatnonzero(phase == 3)
    if len(landing):
        phase = np.where((phase == 3) & (time > time[landing[0]] + STANDING_AFTER), 4, phase)
    return JumpRecord(
        drive=drive,
        time=time,
        q=host(after.bodies.q),
        u=host(after.bodies.u),
        foot_position=host(bodies.r_WF),
        contact_force=host(bodies.contact_force),
        joint_torque=host(drive_output.torque),
        wanted_velocity=host(drive_output.wanted_velocity),
        commanded_velocity=host(drive_output.commanded_velocity),
        motor_velocity=host(after.drive.motor_velocity),
        current=host(drive_output.peak_current),
        voltage=host(drive_output.peak_voltage),
        desired_height=host(ticks.info.desired_height),
        phase=phase,
    )


def write_motion(path: Path, record: JumpRecord) -> None:
    """The motion as compressed NumPy arrays by name (no pickle), written atomically."""
    buffer = io.BytesIO()
    arrays = {name: value for name, value in vars(record).items() if isinstance(value, np.ndarray)}
    np.savez_compressed(buffer, drive=np.array(record.drive), **arrays)
    write_bytes(path, buffer.getvalue())
