"""By how much one sensor of a log is later than another, to a fraction of a sample, with its uncertainty.

A delay is a property of the sensors and of the logger. It is reported for what it is and taken for no physics.
The estimate is the top of the cross-correlation in a band, found on the spectrum, where a fraction of a sample is
exact; its uncertainty is a jackknife over parts of the log, which holds under coloured residuals too.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.signal.windows import tukey

from experiments.measurement.checks.base_links import base_links
from experiments.measurement.checks.joint_links import bench_links, joint_links
from experiments.measurement.checks.leg_links import ground_links
from experiments.measurement.checks.links import Link, usable_columns
from experiments.measurement.checks.matching import Array
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.resample import resample
from mjx_starleth.names import LEGS

# Links whose two sides are the same quantity, so that a phase between them is a delay. A spring's torque leads its
# deflection by its damping, and a controller follows: those are physics.
_SAME_QUANTITY: Final = ("rate", "base rate", "gyroscope", "stance")
_PARTS: Final = 8
_FADED: Final = 0.2
_LEAST_COHERENCE: Final = 0.5
_MOST_SAMPLES: Final = 40.0


@dataclass(frozen=True)
class Delay:
    """`signal` of `name` (joint, axis or leg) is `delay` [s] later than what `against` says, +- `std` [s]."""

    signal: str
    against: str
    name: str
    delay: float
    std: float
    samples: float

    def record(self) -> dict[str, Any]:
        """As `compare` prints it."""
        of = {"signal": self.signal, "against": self.against, "name": self.name}
        return of | {"delay": round(self.delay, 7), "std": round(self.std, 7), "samples": round(self.samples, 3)}


def signal_delays(log: Log, numbers: Mapping[str, Any]) -> list[Delay]:
    """Delays between the sensors of a log that see the same motion, joint by joint; those that can be told."""
    log = resample(log)
    columns, period = usable_columns(log), log.sample_period
    links: list[tuple[str, Link]] = []
    for name in log.joint_names:
        bench = log.joint is not None
        of_joint = bench_links(log.joint, columns, period) if bench else joint_links(name, columns, period, numbers)
        links += [(name, link) for link in of_joint]
    if log.joint is None:
        links += [(leg, link) for leg in LEGS for link in ground_links(leg, columns, period, numbers)]
        links += [(link.columns[0][1], link) for link in base_links(columns, period, numbers)]
    delays = []
    for name, link in links:
        if link.name not in _SAME_QUANTITY:
            continue
        target, terms = link.parts(columns)
        found = estimate_delay(sum(terms), target, period, link.high)
        if found is not None:
            signals = list(dict.fromkeys(signal for signal, _ in link.columns))
            delays.append(Delay(signals[0], signals[1], name, *found, found[0] / period))
    return delays


def estimate_delay(reference: Array, delayed: Array, period: float, high: float) -> tuple[float, float] | None:
    """Delay [s] of `delayed` (T,) or (T, m) after `reference`, and its standard deviation; None if they do not cohere.

    `high` [Hz] is the highest frequency looked at.
    """
    rows = len(reference)
    if rows < 4 * _PARTS:
        return None
    signals = np.stack([x.reshape(rows, -1) - x.mean(0) for x in (reference, delayed)], axis=2) * _fade(rows)
    whole = _CrossSpectrum(signals, period, high)
    if whole.coherence < _LEAST_COHERENCE:
        return None
    delay = whole.polished(whole.steepest())
    edges = np.linspace(0, rows, _PARTS + 1).astype(int)
    without = []
    for start, stop in pairwise(edges):
        rest = signals.copy()
        rest[start:stop] *= 1.0 - _fade(stop - start)
        without.append(_CrossSpectrum(rest, period, high).polished(delay))
    spread = np.array(without) - np.mean(without)
    return delay, float(np.sqrt((_PARTS - 1) / _PARTS * np.sum(spread**2)))


def _fade(rows: int) -> Array:
    return tukey(rows, _FADED)[:, None, None]


class _CrossSpectrum:
    """Cross-spectrum of reference and delayed signal (T, m, 2) up to the frequency `high`."""

    def __init__(self, signals: Array, period: float, high: float):
        length = next_fast_len(2 * len(signals), real=True)  # twice, so that no delay wraps around
        omega = 2.0 * np.pi * np.fft.rfftfreq(length, period)
        inside = (omega > 0) & (omega <= 2.0 * np.pi * high)
        spectra = rfft(signals, length, axis=0)[inside]
        self.period, self.omega = period, omega[inside]
        self.cross = (spectra[..., 0].conj() * spectra[..., 1]).sum(1)
        self.powers = (np.abs(spectra) ** 2).sum((0, 1))

    @property
    def coherence(self) -> float:
        """Squared correlation in the band at the best delay."""
        most = (np.exp(1j * self.omega * self.steepest()) * self.cross).real.sum()
        return float(most**2 / np.maximum(np.prod(self.powers), 1e-300))

    def steepest(self) -> float:
        """The delay of highest correlation, to half a sample."""
        grid = np.arange(-_MOST_SAMPLES, _MOST_SAMPLES + 0.5, 0.5) * self.period
        return float(max(grid, key=lambda delay: (np.exp(1j * self.omega * delay) * self.cross).real.sum()))

    def polished(self, delay: float) -> float:
        """The top of the correlation near `delay`, by Newton's method."""
        for _ in range(4):
            turned = self.cross * np.exp(1j * self.omega * delay)
            slope, curvature = -(self.omega * turned.imag).sum(), -(self.omega**2 * turned.real).sum()
            if curvature >= 0:
                break
            delay -= float(np.clip(slope / curvature, -self.period, self.period))
        return delay
