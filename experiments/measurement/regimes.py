"""In which moments of a joint's motion a model fails: at rest, slow or fast, loaded, turning round, by mode."""

import numpy as np

from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.evidence.row_motion import MeasuredMotion
from experiments.measurement.fits.fit_types import Refitted

Array = np.ndarray

STILL = 0.05  # of the speed that is fast for a joint
LOADED = 0.5  # of the largest torque of the joint
REVERSAL = 0.05  # s around a change of the joint's direction
FEW = 20  # rows: a regime with fewer is not judged
REGIMES = ("still", "slow", "fast", "loaded", "reversing", "position mode", "torque mode")


def regimes(log: Evidence, fit: Refitted, index: int = 0) -> Array | None:
    """Residual over noise (joints, REGIMES) of the index-th log of a fit, NaN in a regime of hardly a row; None where
    the joints have no channels of their own."""
    motion = log.measured_motion()
    if motion is None:
        return None
    rest, *_ = log.rests(fit.points[index])
    square = (rest.residual**2).mean(2)
    table = np.full((square.shape[1], len(REGIMES)), np.nan)
    for k, chosen in enumerate(_masks(motion)):
        count = chosen.sum(0)
        table[:, k] = np.where(count > FEW, np.sqrt((square * chosen).sum(0) / np.maximum(count, 1)), np.nan)
    return table


def _masks(motion: MeasuredMotion) -> tuple[Array, ...]:
    """The rows (T, J) of each of the REGIMES."""
    speed, load = np.abs(motion.velocity) / motion.fast, np.abs(motion.effort)
    direction = np.sign(np.where(speed > STILL, motion.velocity, 0.0))
    turning = np.zeros_like(direction, bool)
    turning[1:] = direction[1:] * direction[:-1] < 0
    around = np.ones(2 * max(round(REVERSAL / motion.period), 1) + 1)
    turning = np.stack([np.convolve(column, around, "same") > 0 for column in turning.T.astype(float)], 1)
    slow, loaded = (speed >= STILL) & (speed < 1.0), load > LOADED * load.max(0)
    return speed < STILL, slow, speed >= 1.0, loaded, turning, motion.position_mode > 0.5, motion.position_mode < 0.5
