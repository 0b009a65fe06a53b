"""Which rows of a log tell something of which body: feet on the ground or sliding, legs that hit nothing."""

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from experiments.measurement.evidence.body_replay import DECIMATION, BodyLog, filter_window, settled, thinned
from experiments.measurement.evidence.drive_evidence import IMPACT

# m/s, and times its velocity's noise, above which a foot slides: what is slower may be the creep of a landing foot
SLIDING, SLIDING_NOISE = 0.15, 5.0
PRESSED = 15.0  # N on a foot, below which the share that friction takes is mostly noise
NEAR_STOP = 0.01  # rad from the end of a joint within which it may touch it


def rows_used(log: BodyLog, sliding: np.ndarray, period: float, clamped: bool, stops: np.ndarray) -> np.ndarray:
    """Which residuals mean something on which row, (N, 26); stops (12, 2): the joints' ends, rad."""
    quiet = settled(log.contact, period)
    share = thinned(log.contact, period)
    n, known = len(quiet), ~knocked(log, period, stops)
    if clamped:
        return np.concatenate([np.zeros((n, 6)), np.repeat(known, 3, 1), np.zeros((n, 8))], 1)
    on = quiet & (share > 0.5)
    flying = quiet & (share < 0.5) & known
    torso = np.repeat((quiet & known).all(1, keepdims=True), 6, 1)
    slides = sliding[around(len(sliding), period)].any(1)
    return np.concatenate([torso, np.repeat(flying, 3, 1), on, slides], 1).astype(float)


def knocked(log: BodyLog, period: float, stops: np.ndarray) -> np.ndarray:
    """(N, 4) True where, within the filter's reach, a leg is at an end of its joints, which pushes as nobody knows, or
    hits something so hard that no row tells how it moved."""
    window = filter_window(period)
    near = maximum_filter1d(hits(log, period, stops), window, axis=0)
    return near[window // 2 : len(near) - window // 2 : DECIMATION]


def hits(log: BodyLog, period: float, stops: np.ndarray) -> np.ndarray:
    """(T, 4) True where a leg is at an end of its joints or hits something."""
    q, turned = log.q[:, 7:], np.abs(np.diff(log.u[:, 6:], axis=0, append=log.u[-1:, 6:]))
    at_end = (q < stops[:, 0] + NEAR_STOP) | (q > stops[:, 1] - NEAR_STOP)
    return (at_end | (turned > IMPACT * period)).reshape(-1, 4, 3).any(2)


def rows_sliding(log: BodyLog, raw: np.ndarray, error: np.ndarray) -> np.ndarray:
    """(T, 4) True where a foot, on the ground in the rows beside as well, slides; error: what noise does to raw."""
    on = minimum_filter1d(log.contact, 3, axis=0) > 0.5
    normal, slip = raw[:, -8:-4], raw[:, -4:]
    noise = np.sqrt((error[:, -4:] ** 2 * on).sum(0) / np.maximum(on.sum(0), 1))
    return on & (slip > np.maximum(SLIDING, SLIDING_NOISE * noise)) & (normal > PRESSED)


def around(rows: int, period: float) -> np.ndarray:
    """Rows (N, DECIMATION) that each row of `thinned` stands for."""
    half = filter_window(period) // 2
    found = np.arange(half, rows - half, DECIMATION)[:, None] + np.arange(DECIMATION) - DECIMATION // 2
    return np.clip(found, 0, rows - 1)
