"""How far a fit is from a log: residual over noise by channel, and chi^2 above the noise and above the floor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.evidence.parts import Part
from experiments.measurement.fits.fit_types import Refitted

FLOOR = 1.15  # residual over noise up to which a channel counts as explained
QUIET = 1.3 * FLOOR  # the same of the worst of many channels of a right model


@dataclass(frozen=True)
class Misfit:
    """Residual over noise of each part's channels, NaN where too little was measured: of drives (J, 3), of bodies
    (26,), of a rigid joint's effort (1, 1)."""

    drive: np.ndarray | None = None
    body: np.ndarray | None = None
    effort: np.ndarray | None = None

    def of(self, part: Part) -> np.ndarray:
        """The channels of a part (…)."""
        return getattr(self, part.name)

    @property
    def worst(self) -> float:
        """The largest of all."""
        parts = [x[np.isfinite(x)] for x in (self.drive, self.body, self.effort) if x is not None]
        values = np.concatenate([p.ravel() for p in parts]) if parts else np.zeros(1)
        return float(values.max()) if len(values) else 0.0


def misfit(log: Evidence, fit: Refitted, index: int, blocks: np.ndarray | None = None) -> Misfit:
    """Residual over noise of one log at a fit, on all blocks or those of a mask."""
    blocks = np.ones(log.blocks, bool) if blocks is None else blocks
    return Misfit(**{rest.part.name: rest.sizes(blocks) for rest in log.rests(fit.points[index])})


def excess(logs: Sequence[Evidence], fit: Refitted) -> float:
    """How far chi^2 lies above that of noise alone, per residual; negative where the noise was taken too large."""
    return fit.total / sum(float(log.weight().sum()) for log in logs) - 1.0


def above_floor(logs: Sequence[Evidence], fit: Refitted) -> float:
    """chi^2 that the channels have above FLOOR."""
    total = 0.0
    for log, point in zip(logs, fit.points, strict=True):
        every = np.ones(log.blocks, bool)
        for rest in log.rests(point):
            over = np.maximum(np.nan_to_num(rest.sizes(every)) ** 2 - FLOOR**2, 0.0)
            total += float((rest.part.noise(every) * over).sum())
    return total
