"""Where an effect acts: what noise alone leaves there, and the misfit that the effect could take away at all."""

from collections.abc import Sequence

import numpy as np

from experiments.effects.effect import Effect
from experiments.effects.places import mask
from experiments.measurement.evidence.body_evidence import FELT_BY_BODIES
from experiments.measurement.evidence.drive_evidence import FELT_BY_DRIVES
from experiments.measurement.evidence.joint_evidence import JointEvidence
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Refitted


def noise_at(
    effect: Effect, where: str, logs: Sequence[Evidence | JointEvidence], blocks: Sequence[np.ndarray]
) -> float:
    """Expected chi^2 of noise alone, on these blocks (masks per log), in the channels of the parts that it acts on."""
    total, hooks = 0.0, set(effect.equations)
    for log, here in zip(logs, blocks, strict=True):
        if isinstance(log, JointEvidence):
            total += float((log.weight() * here).sum())
            continue
        if log.drive is not None and hooks & FELT_BY_DRIVES:
            used = log.drive.used[here[log.block_of_drive()]].sum(0)
            total += float((used.sum(1) * _joints(effect, where, log)).sum())
        if log.body is not None and hooks & FELT_BY_BODIES:
            total += float((log.body.used[here[log.block_of_body()]].sum(0) / log.body.tau).sum())
    return total


def left_at(
    effect: Effect, where: str, logs: Sequence[Evidence | JointEvidence], fit: Refitted, blocks: Sequence[np.ndarray]
) -> float:
    """chi^2 above the noise's, on these blocks (masks per log), in the channels of the parts that an effect acts on.

    A channel that lies below its noise makes up for none that lies above.
    """
    total, hooks = 0.0, set(effect.equations)
    for i, (log, here) in enumerate(zip(logs, blocks, strict=True)):
        if isinstance(log, JointEvidence):
            total += max(float(((fit.chi2[i] - log.weight()) * here).sum()), 0.0)
            continue
        if log.drive is not None and hooks & FELT_BY_DRIVES:
            rows = here[log.block_of_drive()]
            over = (log.drive_residual([fit.points[i]])[0][rows] ** 2 - log.drive.used[rows]).sum(0)
            total += float((np.maximum(over, 0.0).sum(1) * _joints(effect, where, log)).sum())
        if log.body is not None and hooks & FELT_BY_BODIES:
            rows = here[log.block_of_body()]
            over = (log.body_residual([fit.points[i]])[0][rows] ** 2 - log.body.used[rows]).sum(0) / log.body.tau
            over += log.constant_errors(fit.points[i])[here].sum(0)
            total += float(np.maximum(over, 0.0).sum())
    return total


def _joints(effect: Effect, where: str, log: Evidence) -> np.ndarray:
    """(J,) 1.0 at the joints whose drives feel the effect."""
    names = log.atoms.joint_names
    return mask(where, effect.axis, names) if effect.axis == "joint" else np.ones(len(names))
