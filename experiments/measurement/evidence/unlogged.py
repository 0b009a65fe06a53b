"""What stands for what a log does not hold: single missing samples, and velocities that were not logged."""

import numpy as np


def held(table: np.ndarray) -> np.ndarray:
    """Holds the last value over missing samples (T, n), the first one backwards; zeros where nothing was logged."""
    known = np.isfinite(table)
    index = np.where(known, np.arange(len(table))[:, None], -1)
    index = np.maximum.accumulate(index, axis=0)
    first = np.argmax(known, axis=0)
    index = np.where(index < 0, first[None, :], index)
    return np.nan_to_num(np.take_along_axis(table, index, axis=0))


def measured_or(gradient: np.ndarray, velocity: np.ndarray | None) -> np.ndarray:
    """A velocity (T, n) as measured; of columns in which it was not, the gradient of the position."""
    if velocity is None:
        return gradient
    return np.where(np.isfinite(velocity).any(0), held(velocity), gradient)
