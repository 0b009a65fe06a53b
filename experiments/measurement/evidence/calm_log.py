"""A log of the bodies without what noise is in its motion: what numbers change is taken from it.

A residual is linear in masses and accelerations, and so is its noise: the lighter the links, the smaller it is. A fit
to noisy rows therefore makes links light, a bias of least squares with noise in its regressors (Fuller, Measurement
Error Models, doi 10.1002/9780470316665). Wiener's filter keeps, of each signal, the frequencies in which the log holds
more than its sensor's noise: a motion that is nothing but noise changes nothing.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_filter

from experiments.measurement.evidence.body_replay import BodyLog, filter_window

Array = np.ndarray

BAND: Final = 2.0  # Hz over which a spectrum is averaged
OVER: Final = 2.0  # times the noise that is taken away: an average over a band wavers by a quarter
BEYOND: Final = 0.5  # s by which both ends are continued


def calm_log(log: BodyLog, period: float, noise: Mapping[str, float]) -> BodyLog:
    """The log with Wiener's filter on its motion and torque; contacts as they are.

    noise: standard deviations of the sensors by signal name.
    """
    base_q = (("base_position", 3), ("base_orientation", 4), ("joint_position", 12))
    base_u = (("base_linear_velocity", 3), ("base_angular_velocity", 3), ("joint_velocity", 12))
    q, _ = _calm(log.q, period, _stds(noise, base_q))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    u, du = _calm(log.u, period, _stds(noise, base_u))
    torque, _ = _calm(log.torque, period, _stds(noise, (("joint_torque", 12),)))
    return BodyLog(*(np.asarray(table, np.float32) for table in (q, u, du, torque)), log.contact)


def _stds(noise: Mapping[str, float], signals: tuple[tuple[str, int], ...]) -> Array:
    return np.concatenate([np.full(count, noise[name]) for name, count in signals])


def _calm(table: Array, period: float, std: Array) -> tuple[Array, Array]:
    """Columns (T, n) without white noise of std (n,), and their time derivatives."""
    rows, more = len(table), min(round(BEYOND / period), len(table) - 1)
    table = table.astype(float)
    level = savgol_filter(table, filter_window(period), 2, axis=0)  # one noisy end would lift all that continues it
    first, last = 2 * level[0] - table[more:0:-1], 2 * level[-1] - table[-2 : -more - 2 : -1]
    longer = np.concatenate([first, table, last])
    # a straight line from end to end: what is left is periodic
    start, end = 2 * level[0] - level[more], 2 * level[-1] - level[-more - 1]
    slope = (end - start) / (len(longer) - 1)
    line = start + slope * np.arange(len(longer))[:, None]
    spectrum = np.fft.rfft(longer - line, axis=0)
    frequency = np.fft.rfftfreq(len(longer), period)
    bins = max(int(BAND / frequency[1]), 1)
    power = uniform_filter1d(np.abs(spectrum) ** 2, bins, axis=0)
    white = std**2 * len(longer)
    spectrum *= np.maximum(1.0 - OVER * white / np.maximum(power, 1e-300), 0.0)
    turned = spectrum * (2j * np.pi * frequency)[:, None]
    here = slice(more, more + rows)
    back = lambda half: np.fft.irfft(half, len(longer), axis=0)[here]  # noqa: E731
    return back(spectrum) + line[here], back(turned) + slope / period
