"""States of a motion that a law may depend on, row by row beside the residuals: from -1 to 1 over a log."""

from collections.abc import Iterator, Mapping

import numpy as np

from experiments.measurement.evidence.drive_replay import CHANNELS
from experiments.measurement.evidence.joint_evidence import JointEvidence
from experiments.measurement.evidence.log_evidence import Evidence, Point

Array = np.ndarray
States = Mapping[str, Array]  # time, position, speed, load; each of a shape that goes with its part's rows

ENDS = (1.0, 99.0)  # per cent of the rows between which a state goes from -1 to 1
LEAST = 1e-9  # half range below which a state does not change


def states_of(log: Evidence | JointEvidence, point: Point) -> Iterator[States]:
    """The states of each part of a log, in the order of its `local_parts`.

    The drives' load is what their replay at a point predicts: the measured one has the noise of the residual itself,
    which goes with any law that is multiplied by it.
    """
    if isinstance(log, JointEvidence):
        row = slice(0, log.rows, log.filter.stride)
        motion = (np.asarray(x, float)[row, None] for x in (log.log.position, log.log.velocity, log.log.effort))
        yield {name: state[:, 0] for name, state in _states(*motion).items()}
        return
    if log.drive is not None:
        d, rows = log.drive.log, slice(0, log.drive.rows)
        load = d.joint_torque[rows] + _torque_errors(log, point)
        found = _states(*(np.asarray(x, float) for x in (d.joint_position[rows], d.motor_velocity[rows], load)))
        yield {name: state[..., None] for name, state in found.items()}
    if log.body is not None:
        yield _of_bodies(log)


def _torque_errors(log: Evidence, point: Point) -> Array:
    """Predicted less measured joint torque (T, J), N m; zero on rows that do not count."""
    c = CHANNELS.index("joint_torque")
    return log.drive_residual([point])[0][..., c] * log.drive.floor[:, c]


def _of_bodies(log: Evidence) -> States:
    """Of the links' channels, by joint; the torso's and the feet's only know the time."""
    table, names = log.body.log, log.atoms.joint_names
    at = np.minimum(np.round(log.time_of_body() / log.period).astype(int), len(table.torque) - 1)
    robot = hasattr(table, "q")
    position, velocity = (table.q[:, 7:], table.u[:, 6:]) if robot else (table.position, table.velocity)
    joints = _states(*(np.asarray(x[at], float) for x in (position, velocity, table.torque)))
    found = {name: np.zeros((len(at), len(log.body.channels))) for name in joints}
    for c, channel in enumerate(log.body.channels):
        place = channel.partition("/")[2]
        for name, state in joints.items():
            if place in names:
                found[name][:, c] = state[:, names.index(place)]
            elif name == "time":
                found[name][:, c] = state[:, 0]
    return found


def _states(position: Array, velocity: Array, load: Array) -> dict[str, Array]:
    """Of rows (T, J)."""
    time = np.broadcast_to(np.arange(len(position), dtype=float)[:, None], position.shape)
    states = {"time": time, "position": position, "speed": np.abs(velocity), "load": np.abs(load)}
    return {name: _unit(state) for name, state in states.items()}


def _unit(x: Array) -> Array:
    low, high = np.percentile(x, ENDS, axis=0)
    return np.clip((x - 0.5 * (low + high)) / np.maximum(0.5 * (high - low), LEAST), -1.0, 1.0)
