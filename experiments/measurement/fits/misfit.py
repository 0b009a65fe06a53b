"""How far a fit is from a log: residual over noise by channel, and chi^2 above the noise and above the floor."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.measurement.evidence.body_evidence import enough
from experiments.measurement.evidence.joint_evidence import JointEvidence
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Refitted

FLOOR = 1.15  # residual over noise up to which a channel counts as explained


@dataclass(frozen=True)
class Misfit:
    """Residual over noise: by drive channel and joint (3, J), by body channel (26,), NaN where nothing was measured;
    effort (1,) of a rigid joint."""

    drive: np.ndarray | None = None
    body: np.ndarray | None = None
    effort: np.ndarray | None = None

    @property
    def worst(self) -> float:
        """The largest of all."""
        parts = [x[np.isfinite(x)] for x in (self.drive, self.body, self.effort) if x is not None]
        values = np.concatenate([p.ravel() for p in parts]) if parts else np.zeros(1)
        return float(values.max()) if len(values) else 0.0


def misfit(log: Evidence | JointEvidence, fit: Refitted, index: int, blocks: np.ndarray | None = None) -> Misfit:
    """Residual over noise of one log at a fit, on all blocks or those of a mask.

    Constant errors of the bodies count as the unlikely thing that they are, not on each row.
    """
    point = fit.points[index]
    blocks = np.ones(log.blocks, bool) if blocks is None else blocks
    if isinstance(log, JointEvidence):
        here = blocks[log.block_of_rows()]
        square = log.residual([point])[0][here] ** 2
        return Misfit(effort=np.sqrt(square.sum(keepdims=True) / max(log.used[here].sum(), 1)))
    drive = body = None
    if log.drive is not None:
        here = blocks[log.block_of_drive()]
        count = log.drive.used[here].sum(0)
        drive = np.sqrt((log.drive_residual([point])[0][here] ** 2).sum(0) / np.maximum(count, 1.0)).T
    if log.body is not None:
        here = blocks[log.block_of_body()]
        r, used = log.body_residual([point])[0][here], log.body.used[here]
        count = used.sum(0)
        # smoothed rows share their noise: what is slower than the filter is weighed as it deserves
        square = (r**2).sum(0) + log.body.tau * log.constant_errors(point)[blocks].sum(0)
        size = np.sqrt(square / np.maximum(count, 1))
        body = np.where(enough(log.body.channels, count), size, np.nan)
    return Misfit(drive, body)


def excess(logs: Sequence[Evidence], fit: Refitted) -> float:
    """How far chi^2 lies above that of noise alone, per residual; negative where the noise was taken too large."""
    return fit.total / sum(float(log.weight().sum()) for log in logs) - 1.0


def above_floor(logs: Sequence[Evidence], fit: Refitted) -> float:
    """chi^2 that the channels have above FLOOR."""
    return sum(
        float((counts * np.maximum(np.nan_to_num(sizes) ** 2 - FLOOR**2, 0.0)).sum())
        for i, log in enumerate(logs)
        for counts, sizes in _sizes(log, fit, i)
    )


def _sizes(log: Evidence | JointEvidence, fit: Refitted, index: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Independent residuals and their size over noise, for the channels of each part of a log."""
    found = misfit(log, fit, index)
    if isinstance(log, JointEvidence):
        yield log.used.sum(keepdims=True), found.effort
        return
    if found.drive is not None:
        yield log.drive.used.sum(0).T, found.drive
    if found.body is not None:
        yield log.body.used.sum(0) / log.body.tau, found.body
