"""Joint positions against the end stops of this robot: a flipped, rescaled or misplaced joint leaves them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from experiments.measurement.checks.links import Column, Columns
from experiments.measurement.checks.matching import Match
from mjx_starleth.names import JOINT_NAMES, JOINT_SIGN

# rad; stops give way, encoders are off, and the hips are moved a little past their stops in tests in the air
_MARGIN: Final = 0.35
_FREEDOM: Final = 60.0  # a pose says far less than its thousands of samples


@dataclass(frozen=True)
class Posture:
    """Looks like a `Link`: its misfit is the share of samples beyond the stops."""

    joint: str
    low: float
    high: float
    name: str = "posture"
    floor: float = 0.02

    @property
    def columns(self) -> tuple[Column, ...]:
        return (("joint_position", self.joint),)

    def match(self, columns: Columns, period: float) -> Match:
        q = columns[self.columns[0]]
        return Match(float(((q < self.low) | (q > self.high)).mean()), 0.0, np.ones(1), _FREEDOM)

    still_match = match

    def free_match(self, columns: Columns, period: float, most_lag: float) -> Match:
        return self.match(columns, period)


def posture(joint: str, numbers: Mapping[str, Any]) -> Posture:
    """The end stops of a joint, mirrored from those of the left fore leg, with a margin."""
    sign = JOINT_SIGN[JOINT_NAMES.index(joint)]
    low, high = sorted(sign * stop for stop in numbers["joint_limits_LF"][joint[-3:]])
    return Posture(joint, low - _MARGIN, high + _MARGIN)
