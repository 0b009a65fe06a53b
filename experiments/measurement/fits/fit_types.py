"""What is fitted, and what a fit is: effects at places, nominal numbers, the result."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from experiments.measurement.evidence.log_evidence import Point

Masks = Sequence[np.ndarray]  # of each log, the blocks (blocks,) that are meant


class Placed(NamedTuple):
    """An effect at a place with its parameters."""

    effect: str
    where: str
    parameters: Mapping[str, float]

    def values(self) -> Mapping[str, float]:
        return self.parameters


class Nominal(NamedTuple):
    """A nominal number of the robot that may be a little off: an effect's strength, and its prior's deviation."""

    effect: str
    where: str
    parameter: str
    deviation: float


@dataclass(frozen=True)
class Refitted:
    """A fit."""

    effects: tuple[Placed, ...]
    nominal: np.ndarray  # (k,) fitted deviations, in each one's own unit
    spread: np.ndarray  # (k,) their standard deviations; as the last fit with them free had them
    points: tuple[Point, ...]  # one per log
    chi2: tuple[np.ndarray, ...]  # (blocks,) per log
    covariance: np.ndarray  # (p, p) of the effects' parameters, in their order

    @property
    def total(self) -> float:
        return float(sum(c.sum() for c in self.chi2))
