"""The filter that a rigid joint's effort and its model pass alike, and which rows are judged behind it."""

from dataclasses import dataclass

import numpy as np

from experiments.measurement.evidence.joint_replay import JointLog, low_pass, moving

REACH = 3.0  # periods of the corner from a log's end, within which filters do not know what was before


@dataclass(frozen=True)
class Filter:
    """The zero-phase filter that everything passes, and the rows that are independent after it."""

    frequency: float  # Hz, corner
    period: float  # s

    @property
    def stride(self) -> int:
        """Rows of the log per judged row: two to a period of the corner."""
        return max(1, round(0.5 / (self.frequency * self.period)))

    def log(self, position: np.ndarray, effort: np.ndarray) -> JointLog:
        return moving(position, effort, self.frequency, self.period)

    def inner(self, rows: int) -> np.ndarray:
        """1.0 for the judged rows (N,) of a log of so many rows that the filter's ends do not reach."""
        count = -(-rows // self.stride)
        ends = round(REACH / (self.frequency * self.period * self.stride))
        found = np.zeros(count)
        found[ends : count - ends] = 1.0
        return found

    def thinned(self, rows: np.ndarray) -> np.ndarray:
        """(H, T) filtered, every stride-th row of it: (H, N)."""
        return low_pass(np.asarray(rows, float), self.frequency, self.period)[:, :: self.stride]
