"""How much of one signal others explain, with unknown gains and an unknown delay: least squares in a frequency band.

All on a uniform grid. Working on the spectrum makes a delay of a fraction of a sample exact, and leaves out the
frequencies where there is only noise.
"""

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal.windows import tukey

Array = NDArray[np.float64]

_TAPERED: Final = 0.1  # share of the record faded in and out, so that its ends do not leak over the band
_FINENESS: Final = 2  # lags looked at within a sample; the parabola through them does the rest
_SETTLED: Final = 1e-4
_SWEEPS: Final = 30  # of coordinate descent, over at most four terms


class Match(NamedTuple):
    """The best fit target(t) ~ sum gain_k term_k(t - lag)."""

    misfit: float  # power of target - fit over the sum of their powers: 0 the same, 1 unrelated, 2 opposite
    lag: float  # samples by which the target comes after the terms
    gains: Array  # (k,)
    freedom: float  # independent real numbers in the band


def match(
    target: Array,
    terms: list[Array],
    bounds: list[tuple[float, float]],
    lags: tuple[float, float],
    band: tuple[float, float],
) -> Match:
    """Fit `target` (T,) or (T, m) by `terms` of the same shape.

    `bounds` of each gain, `lags` searched in samples, `band` in cycles per sample. Means are left out.
    """
    spectra, first, length = _spectra(np.stack([target, *terms], axis=-1), band)
    power = (np.abs(spectra[..., 0]) ** 2).sum()
    if not power > 0:
        return Match(1.0, 0.0, np.zeros(len(terms)), 0.0)
    others = spectra[..., 1:].reshape(-1, len(terms))
    gram = (others.conj().T @ others).real
    along = others.conj() * spectra[..., 0].reshape(-1, 1)
    lag = np.arange(lags[0] * _FINENESS, lags[1] * _FINENESS + 0.5) / _FINENESS
    cross = _at_lags(along.reshape(len(spectra), -1, len(terms)).sum(1), first, length, lag)
    gains = _bounded(gram, cross, bounds)
    fitted = ((gains @ gram) * gains).sum(1)
    # over both powers, so that a fit that is all noise counts as unrelated and not as worse than that
    misfits = 1.0 - 2.0 * (gains * cross).sum(1) / (power + fitted)
    best = int(np.argmin(misfits))
    freedom = 2.0 * (1.0 - _TAPERED) * spectra[..., 0].size
    return Match(max(float(misfits[best]), 0.0), _refined(lag, misfits, best), gains[best], freedom)


def _at_lags(along: NDArray[np.complex128], first: int, length: int, lag: Array) -> Array:
    """c_k(lag) = Re sum_f conj(term_k) target e^{2 pi i f lag} at all lags at once: an inverse transform."""
    full = np.zeros((length * _FINENESS // 2 + 1, along.shape[1]), dtype=complex)
    full[first : first + len(along)] = along
    correlation = irfft(full, length * _FINENESS, axis=0) * (length * _FINENESS / 2)
    return correlation[np.round(lag * _FINENESS).astype(int) % len(correlation)]


def _spectra(signals: Array, band: tuple[float, float]) -> tuple[NDArray[np.complex128], int, int]:
    """Spectra (bins, ..., k) of tapered signals (T, ..., k) in the band, its first bin and the transform's length."""
    rows = signals.shape[0]
    taper, length = _window(rows)
    first, last = (math.ceil(max(edge, 1.0 / rows) * length) for edge in band)
    centred = (signals - signals.mean(0)) * taper.reshape(-1, *(1,) * (signals.ndim - 1))
    return rfft(centred, length, axis=0)[first:last], first, length


@lru_cache(maxsize=8)
def _window(rows: int) -> tuple[Array, int]:
    return tukey(rows, _TAPERED), 2 * next_fast_len((rows + 1) // 2)


def _bounded(gram: Array, cross: Array, bounds: list[tuple[float, float]]) -> Array:
    """Least squares within bounds for every row of `cross` (lags, k): closed form, where it leaves them by descent."""
    low, high = np.array(bounds).T
    scale = np.where(np.diag(gram) > 0, np.diag(gram), 1.0)
    ridge = np.diag(1e-12 * scale)  # terms may be nothing or alike
    gains = np.linalg.solve(gram + ridge, cross.T).T
    outside = ((gains < low) | (gains > high)).any(1)
    if outside.any():
        gains[outside] = _descended(gram, cross[outside], np.clip(gains[outside], low, high), scale, low, high)
    return gains


def _descended(gram: Array, cross: Array, gains: Array, scale: Array, low: Array, high: Array) -> Array:
    """Coordinate descent on the same least squares, from `gains` inside the bounds."""
    for _ in range(1 if gram.shape[0] == 1 else _SWEEPS):
        before = gains.copy()
        for k in range(gram.shape[0]):
            step = (cross[:, k] - gains @ gram[:, k]) / scale[k]
            gains[:, k] = np.minimum(np.maximum(gains[:, k] + step, low[k]), high[k])
        if np.abs(gains - before).max() <= _SETTLED * np.abs(gains).max():
            break
    return gains


def _refined(lag: Array, misfits: Array, best: int) -> float:
    """Vertex of the parabola through the best lag and its neighbours."""
    if not 0 < best < len(lag) - 1:
        return float(lag[best])
    left, middle, right = misfits[best - 1 : best + 2]
    curvature = left - 2.0 * middle + right
    step = 0.5 * (left - right) / curvature if curvature > 0 else 0.0
    return float(lag[best] + np.clip(step, -0.5, 0.5) * (lag[1] - lag[0]))
