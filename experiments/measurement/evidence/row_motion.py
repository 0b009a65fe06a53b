"""The joints' motion beside the residuals of a part of the plant, and what of it a rest may go with."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

Array = np.ndarray

ENDS = (1.0, 99.0)  # per cent of the rows between which a state goes from -1 to 1
LEAST = 1e-9  # half range below which a state does not change
STILL = 0.05  # of the largest speed: no direction


class RowMotion(NamedTuple):
    """Of the joints (N, J) on a part's rows: rad, rad/s, N m (m, m/s, N of a prismatic one)."""

    position: Array
    velocity: Array
    load: Array

    def states(self) -> dict[str, Array]:
        """What a law may change with, each from -1 to 1 over the log: (N, J)."""
        time = np.broadcast_to(np.arange(len(self.position), dtype=float)[:, None], self.position.shape)
        states = {"time": time, "position": self.position, "speed": np.abs(self.velocity), "load": np.abs(self.load)}
        return {name: _unit(state) for name, state in states.items()}

    def inputs(self) -> dict[str, Array]:
        """What a rest at the joints may go with, in words: (N, J)."""
        still = STILL * np.abs(self.velocity).max(0, initial=0.0)
        time = np.broadcast_to(np.arange(len(self.position), dtype=float)[:, None], self.position.shape)
        return {
            "joint position": self.position,
            "joint speed": self.velocity,
            "direction of motion": np.where(np.abs(self.velocity) > still, np.sign(self.velocity), 0.0),
            "load": self.load,
            "time": time,
        }


class Inputs(NamedTuple):
    """What the rest of a part may go with, in words: at the joints (N, J), elsewhere (N,)."""

    joints: Mapping[str, Array]
    elsewhere: Mapping[str, Array] = {}

    def beside(self, joint: int) -> Mapping[str, Array]:
        """Of a channel (N,): its joint's, or those of one that belongs to none (-1)."""
        return self.elsewhere if joint < 0 else {name: x[:, joint] for name, x in self.joints.items()}


class MeasuredMotion(NamedTuple):
    """The joints (N, J) as they were measured on the rows of their own channels, for a map of regimes."""

    velocity: Array
    effort: Array
    position_mode: Array  # 1.0 in position mode, 0.0 in torque mode, NaN of a joint without modes
    period: float  # s
    fast: float  # speed that is fast for such a joint


def row_motion(*tables: Array) -> RowMotion:
    """Of position, velocity and load (N, J), in double precision."""
    return RowMotion(*(np.asarray(table, float) for table in tables))


def _unit(x: Array) -> Array:
    low, high = np.percentile(x, ENDS, axis=0)
    return np.clip((x - 0.5 * (low + high)) / np.maximum(0.5 * (high - low), LEAST), -1.0, 1.0)
