"""Where a ripple of the motors' torque may have its lines: the error has one narrow valley per harmonic.

What a torque at the rotor does, the current loops make up for at once: the current that the replay lacks, seen over the
motor's angle, shows it.
"""

from typing import Final

import numpy as np

from experiments.measurement.evidence.drive_evidence import DriveEvidence
from experiments.measurement.evidence.drive_replay import CHANNELS

HARMONICS: Final = np.arange(30.0, 2500.0, 2.0)  # periods per turn of the gear output; legs move by about a radian
NEAR: Final = 20  # lines of the grid that a line has to stand out from, to both sides
LINES: Final = 4


def ripple_lines(drive: DriveEvidence, residual: np.ndarray) -> tuple[float, ...]:
    """The LINES harmonics that stand out most in any joint's missing current, of a residual (T, J, 3)."""
    c, rows = CHANNELS.index("motor_current"), drive.rows
    angle, current = drive.log.motor_position[:rows].astype(float), drive.measured[..., c].astype(float)
    missing = residual[..., c].astype(float)
    spectrum = np.maximum(_power(angle, missing), _power(angle, missing * _unit(current)))
    contrast = np.stack([_contrast(column) for column in spectrum.T]).max(0)
    found: list[float] = []
    for i in np.argsort(-contrast):
        if all(abs(HARMONICS[i] - other) > NEAR for other in found):
            found.append(float(HARMONICS[i]))
        if len(found) == LINES:
            break
    return tuple(found)


def _power(angle: np.ndarray, signal: np.ndarray) -> np.ndarray:
    """|sum of signal exp(i n angle)|^2 for all HARMONICS n: (n, J) of (T, J)."""
    turn = np.exp(1j * (HARMONICS[1] - HARMONICS[0]) * angle)
    now = (signal - signal.mean(0)) * np.exp(1j * HARMONICS[0] * angle)
    found = np.empty((len(HARMONICS), angle.shape[1]))
    for i in range(len(HARMONICS)):
        found[i] = np.abs(now.sum(0)) ** 2
        now *= turn
    return found


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.maximum(np.sqrt((x**2).mean(0)), 1e-9)


def _contrast(power: np.ndarray) -> np.ndarray:
    """Each line over the median of those around it."""
    padded = np.pad(power, NEAR, mode="reflect")
    around = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * NEAR + 1), axis=1)
    return power / np.maximum(around, 1e-12 * power.max() + 1e-300)
