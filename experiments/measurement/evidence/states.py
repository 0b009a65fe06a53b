"""The motion that a law may depend on, row by row beside the residuals, and states of it from -1 to 1 over a log."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from experiments.measurement.evidence.drive_replay import CHANNELS
from experiments.measurement.evidence.joint_evidence import JointEvidence
from experiments.measurement.evidence.log_evidence import Evidence, Point

Array = np.ndarray
States = Mapping[str, Array]  # time, position, speed, load; each of a shape that goes with its part's rows

ENDS = (1.0, 99.0)  # per cent of the rows between which a state goes from -1 to 1
LEAST = 1e-9  # half range below which a state does not change


class JointMotion(NamedTuple):
    """Of the joints (T, J) on a part's rows: rad, rad/s, N m (m, m/s, N of a prismatic one)."""

    position: Array
    velocity: Array
    load: Array

    def states(self) -> dict[str, Array]:
        time = np.broadcast_to(np.arange(len(self.position), dtype=float)[:, None], self.position.shape)
        states = {"time": time, "position": self.position, "speed": np.abs(self.velocity), "load": np.abs(self.load)}
        return {name: _unit(state) for name, state in states.items()}


def bench_motion(log: JointEvidence) -> JointMotion:
    """Of a rigid joint, on the rows that are judged."""
    row = slice(0, log.rows, log.filter.stride)
    return _motion(*(x[row, None] for x in (log.log.position, log.log.velocity, log.log.effort)))


def drive_motion(log: Evidence, point: Point) -> JointMotion:
    """Of the drives; the velocity is the motor's.

    The load is what their replay at a point predicts, on rows that count: the measured one has the noise of the
    residual itself, which goes with any law that is multiplied by it.
    """
    table, rows, c = log.drive.log, slice(0, log.drive.rows), CHANNELS.index("joint_torque")
    error = log.drive_residual([point])[0][..., c] * log.drive.floor[:, c]
    return _motion(table.joint_position[rows], table.motor_velocity[rows], table.joint_torque[rows] + error)


def body_rows(log: Evidence) -> Array:
    """Rows of the log (N,) beside the residuals of the bodies."""
    return np.minimum(np.round(log.time_of_body() / log.period).astype(int), len(log.body.log.torque) - 1)


def body_motion(log: Evidence) -> JointMotion:
    """Of the links' joints, beside the residuals of the bodies."""
    table, at = log.body.log, body_rows(log)
    robot = hasattr(table, "q")
    position, velocity = (table.q[:, 7:], table.u[:, 6:]) if robot else (table.position, table.velocity)
    return _motion(position[at], velocity[at], table.torque[at])


def states_of(log: Evidence | JointEvidence, point: Point) -> Iterator[States]:
    """The states of each part of a log, in the order of its `local_parts`."""
    if isinstance(log, JointEvidence):
        yield {name: state[:, 0] for name, state in bench_motion(log).states().items()}
        return
    if log.drive is not None:
        yield {name: state[..., None] for name, state in drive_motion(log, point).states().items()}
    if log.body is not None:
        yield _by_channel(log, body_motion(log).states())


def _by_channel(log: Evidence, joints: States) -> States:
    """Of the bodies' channels: each link's by its joint; the torso's and the feet's only know the time."""
    names = log.atoms.joint_names
    found = {name: np.zeros((len(state), len(log.body.channels))) for name, state in joints.items()}
    found["time"] += joints["time"][:, :1]
    for c, channel in enumerate(log.body.channels):
        place = channel.partition("/")[2]
        if place in names:
            for name, state in joints.items():
                found[name][:, c] = state[:, names.index(place)]
    return found


def _motion(*tables: Array) -> JointMotion:
    return JointMotion(*(np.asarray(table, float) for table in tables))


def _unit(x: Array) -> Array:
    low, high = np.percentile(x, ENDS, axis=0)
    return np.clip((x - 0.5 * (low + high)) / np.maximum(0.5 * (high - low), LEAST), -1.0, 1.0)
