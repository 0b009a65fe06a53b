"""States from -1 to 1 over a log that a law may change with, row by row beside the columns of a fit."""

from collections.abc import Iterator, Mapping

import numpy as np

from experiments.measurement.evidence.log_evidence import Evidence, Point

Array = np.ndarray
States = Mapping[str, Array]  # time, position, speed, load; each of a shape that goes with its part's rows


def states_of(log: Evidence, point: Point) -> Iterator[States]:
    """The states of each part of a log, in the order of its `local_parts`."""
    for part, motion in zip(log.parts, log.motions(point), strict=True):
        yield {name: _by_channel(name, state, part.joint) for name, state in motion.states().items()}


def _by_channel(name: str, state: Array, joint: Array) -> Array:
    """Each channel's by its joint, of (N, J); one that belongs to none only knows the time."""
    if name == "time":
        return state[:, np.maximum(joint, 0)]
    return np.where(joint >= 0, state[:, joint], 0.0)
