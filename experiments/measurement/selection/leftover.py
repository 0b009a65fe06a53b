"""What the unexplained rest goes with: the inputs and states that it follows, in sign or in size.

A residual that nothing explains is no noise if it correlates with something. Which, is the best hint at the effect
that the library lacks. Correlations are judged by the scatter of the blocks' products, which holds under coloured
residuals.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from experiments.measurement.evidence.blocks import sum_blocks
from experiments.measurement.evidence.log_evidence import Evidence, Point
from experiments.measurement.fits.fit_types import Refitted

Array = np.ndarray

ABOVE = 1.3  # residual over noise from which a channel has something left to explain
SURE = 3.0  # standard deviations, by the blocks' scatter
LEAST = 0.15  # correlation below which nobody could see it
BY_SIZE = 0.7  # of a correlation counts where only sizes go together, which tells less
MOST = 5  # hints given
WORDS = {"follows": "goes with {}", "grows": "is larger where {} is large"}


class Hint(NamedTuple):
    """A channel's rest and what it goes with. way: `follows` the input, or `grows` with it, whatever its sign."""

    log: str
    channel: str
    over_noise: float
    input: str
    way: str
    correlation: float

    def in_words(self) -> str:
        return f"{self.channel} {WORDS[self.way].format('the ' + self.input)} (correlation {self.correlation:+.2f})"


def hints(logs: Sequence[Evidence], fit: Refitted) -> list[Hint]:
    """The strongest hint of each channel that a fit leaves above the noise, the worst channels first."""
    found = []
    for log, point in zip(logs, fit.points, strict=True):
        for name, rest, used, block, inputs in _channels(log, point):
            size = float(np.sqrt((rest**2).sum() / max(used.sum(), 1.0)))
            if size > ABOVE and (best := _best(rest, used, block, log.blocks, inputs)):
                found.append(Hint(log.name, name, round(size, 3), *best))
    return sorted(found, key=lambda h: -h.over_noise * abs(h.correlation))[:MOST]


def _channels(log: Evidence, point: Point) -> Iterator[tuple[str, Array, Array, Array, Mapping[str, Array]]]:
    """Each channel: name, rest over noise (N,), rows that count, their blocks, and what it may go with."""
    for rest, inputs in zip(log.rests(point), log.inputs(point), strict=True):
        part = rest.part
        joint = np.broadcast_to(part.joint, part.channels.shape)
        for c in np.ndindex(part.channels.shape):
            its = (slice(None), *c)
            yield str(part.channels[c]), rest.residual[its], part.used[its], part.block, inputs.beside(joint[c])


def _best(rest: Array, used: Array, block: Array, blocks: int, inputs: Mapping[str, Array]):
    """(input, way, correlation) of the input that a rest (N,) goes with most clearly; None if with none."""
    judged = []
    for name, x in inputs.items():
        judged.append((name, "follows", *_correlation(rest, x, used, block, blocks)))
        if not name.startswith("direction"):
            judged.append((name, "grows", *_correlation(np.abs(rest), np.abs(x), used, block, blocks)))
    sure = [one for one in judged if one[3] > SURE and abs(one[2]) > LEAST]
    if not sure:
        return None
    name, way, correlation, _ = max(sure, key=lambda one: abs(one[2]) * (BY_SIZE if one[1] == "grows" else 1.0))
    return name, way, round(correlation, 3)


def _correlation(y: Array, x: Array, used: Array, block: Array, blocks: int) -> tuple[float, float]:
    """Correlation of two series (N,) on the rows that count, and how many deviations it is from chance."""
    count = max(used.sum(), 1.0)
    y = (y - (y * used).sum() / count) * used
    x = (x - (x * used).sum() / count) * used
    both = np.sqrt((y @ y) * (x @ x))
    if not both > 0:
        return 0.0, 0.0
    parts = sum_blocks((x * y)[None], block, blocks)[0]
    spread = np.sqrt(blocks) * parts.std(ddof=1) if blocks > 1 else np.inf
    return float(parts.sum() / both), float(abs(parts.sum()) / max(spread, 1e-12 * both))
