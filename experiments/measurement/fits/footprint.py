"""Where an effect acts: what noise alone leaves there, and the misfit that the effect could take away at all."""

from collections.abc import Sequence

import numpy as np

from experiments.effects.effect import Effect
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Refitted


def noise_at(effect: Effect, where: str, logs: Sequence[Evidence], blocks: Sequence[np.ndarray]) -> float:
    """Expected chi^2 of noise alone, on these blocks (masks per log), in the channels of the parts that it acts on."""
    total = 0.0
    for log, here in zip(logs, blocks, strict=True):
        for part in log.parts:
            total += float((part.noise(here) * part.shows(effect, where, log.atoms.joint_names)).sum())
    return total


def left_at(effect: Effect, where: str, logs: Sequence[Evidence], fit: Refitted, blocks: Sequence[np.ndarray]) -> float:
    """chi^2 above the noise's, on these blocks (masks per log), in the channels of the parts that an effect acts on.

    A channel that lies below its noise makes up for none that lies above.
    """
    total = 0.0
    for log, point, here in zip(logs, fit.points, blocks, strict=True):
        for rest in log.rests(point):
            total += float((rest.above_noise(here) * rest.part.shows(effect, where, log.atoms.joint_names)).sum())
    return total
