"""The parts of the plant that a log measures, and what a fit leaves of each: counted alike, whatever they are of."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from experiments.effects.effect import Effect
from experiments.effects.places import mask
from experiments.measurement.evidence.blocks import sum_blocks

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Part:
    """One part of the plant on its N rows of a log. The shape of its channels, (…) below, is (joints, signals) where
    each joint has its own, and (channels,) of the bodies."""

    name: Literal["drive", "body", "effort"]
    channels: Array  # (…) names
    joint: Array  # the joint that a channel belongs to, -1 for none; of a shape that goes with the channels'
    used: Array  # (N, …) 1.0 on the rows that count
    block: Array  # (N,)
    felt: frozenset[str]  # hooks whose effects show in it
    tau: Array | float = 1.0  # (…) rows that carry as much as one independent row
    fewest: int = 1  # rows of a channel that tell its size
    coupled: bool = False  # an effect at one joint shows in all channels, as it does in moving bodies

    def chi2(self, residual: Array, blocks: int) -> Array:
        """Sum of squared residuals (H, N, …) over each block, rows thinned to independent ones: (H, blocks)."""
        square = (residual / np.sqrt(self.tau)) ** 2
        return sum_blocks(square.reshape(*square.shape[:2], -1).sum(2), self.block, blocks)

    def weight(self, blocks: int) -> Array:
        """Expected chi^2 of noise alone per block (blocks,)."""
        independent = (self.used / self.tau).reshape(len(self.used), -1).sum(1)
        return sum_blocks(independent[None], self.block, blocks)[0]

    def noise(self, blocks: Array) -> Array:
        """The same per channel (…), on a mask of blocks."""
        return self.used[blocks[self.block]].sum(0) / self.tau

    def shows(self, effect: Effect, where: str, joint_names: tuple[str, ...]) -> Array:
        """1.0 for the channels in which an effect at a place shows, of a shape that goes with theirs."""
        if not self.felt & set(effect.equations):
            return np.zeros(1)
        if self.coupled or effect.axis != "joint":
            return np.ones(1)
        return mask(where, effect.axis, joint_names)[self.joint]


@dataclass(frozen=True, eq=False)
class Rest:
    """What is left of a part at a point."""

    part: Part
    residual: Array  # (N, …) over noise, zero on rows that do not count
    constant: Array  # (blocks, …) chi^2 of the channels' constant errors, which the residual no longer has

    def sizes(self, blocks: Array) -> Array:
        """RMS over noise of each channel (…) on a mask of blocks, NaN where too few rows count.

        Constant errors count as the unlikely thing that they are, not on each row.
        """
        here = blocks[self.part.block]
        count = self.part.used[here].sum(0)
        # smoothed rows share their noise: what is slower than the filter is weighed as it deserves
        square = (self.residual[here] ** 2).sum(0) + self.part.tau * self.constant[blocks].sum(0)
        size = np.sqrt(square / np.maximum(count, 1))
        return np.where(enough(self.part.channels, count, self.part.fewest), size, np.nan)

    def above_noise(self, blocks: Array) -> Array:
        """chi^2 above the noise's in each channel (…); one that lies below its noise has none."""
        here = blocks[self.part.block]
        over = (self.residual[here] ** 2 - self.part.used[here]).sum(0) / self.part.tau
        return np.maximum(over + self.constant[blocks].sum(0), 0.0)


def enough(channels: Array | Sequence[str], count: Array, fewest: int) -> Array:
    """Which channels have rows enough to tell their size; the feet slide on one ground and count together."""
    feet = np.char.startswith(np.asarray(channels), "friction/")
    together = np.where(feet, (count * feet).sum(), count)
    return (together >= fewest) & (count > 0)
