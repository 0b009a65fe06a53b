"""`starleth compare`: where does the model fail on a log, and by how much over the sensors' noise?"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.effects.effect import Effect
from experiments.measurement.evidence.body_replay import DECIMATION, SMOOTHING
from experiments.measurement.evidence.drive_replay import CHANNELS as DRIVE_CHANNELS
from experiments.measurement.evidence.gather import gather
from experiments.measurement.evidence.joint_evidence import JointEvidence
from experiments.measurement.evidence.log_evidence import Evidence, Point
from experiments.measurement.evidence.parts import Rest
from experiments.measurement.evidence.robot_evidence import RobotEvidence
from experiments.measurement.fits.fit_types import Refitted
from experiments.measurement.fits.misfit import QUIET, Misfit, misfit
from experiments.measurement.fits.nominal import never_given
from experiments.measurement.fits.refit import refit
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.noise_floor import noise_of
from experiments.measurement.regimes import REGIMES, regimes
from experiments.model import Model

WHITE_LAG = 10  # rows over which the residual's autocorrelation is judged


@dataclass(frozen=True)
class Channel:
    """How well one channel of one joint (or of the bodies) is predicted."""

    name: str  # signal/place
    error: float  # RMS, in the channel's unit
    over_noise: float
    fit: float | None  # per cent of the measured variation that is predicted
    whiteness: float | None  # 1: white; RMS autocorrelation of the residual over what white noise has

    def cells(self) -> tuple[str, str, str, str]:
        """Error, error over noise, fit and whiteness for a table."""
        fit = "" if self.fit is None else f"{self.fit:.2f}" if self.fit > 0 else "none"
        white = "" if self.whiteness is None else f"{self.whiteness:.1f}"
        return f"{self.error:.3g}", f"{self.over_noise:.2f}", fit, white


@dataclass(frozen=True)
class Comparison:
    """A log against a model."""

    log: Evidence
    fit: Refitted
    misfit: Misfit
    channels: tuple[Channel, ...]
    regimes: np.ndarray | None  # (joints, REGIMES) residual over noise of the drive, NaN where there is no such row

    @property
    def worst(self) -> Channel:
        return max(self.channels, key=lambda c: c.over_noise)

    @property
    def explained(self) -> bool:
        return all(c.over_noise <= QUIET for c in self.channels)

    def in_words(self) -> str:
        """The comparison in one or two sentences."""
        return " ".join(filter(None, (self._verdict(), self.log.not_judged)))

    def _verdict(self) -> str:
        name, worst = self.log.name, self.worst
        at = f"{worst.name}: {worst.over_noise:.2f} times the noise"
        if self.explained:
            return f"The model explains {name} down to the sensors' noise; worst is {at}."
        failing = [c for c in self.channels if c.over_noise > QUIET]
        where = f"{len(failing)} of {len(self.channels)} channels" if len(self.channels) > 1 else "its channel"
        return f"The model fails on {name} in {where}; worst is {at}. `starleth diagnose` asks which effect is missing."

    def answer(self) -> dict[str, Any]:
        """What `compare` prints as JSON."""
        return {
            "log": self.log.name,
            "text": self.in_words(),
            "worst_channel": self.worst.name,
            "worst_over_noise": round(self.worst.over_noise, 3),
            "explained": self.explained,
            "channels": [
                {
                    "name": c.name,
                    "error": float(f"{c.error:.6g}"),
                    "error_over_noise": round(c.over_noise, 3),
                    "fit_percent": None if c.fit is None else round(c.fit, 2),
                    "whiteness": None if c.whiteness is None else round(c.whiteness, 2),
                }
                for c in self.channels
            ],
            "regimes": None
            if self.regimes is None
            else {
                name: {r: round(float(v), 2) for r, v in zip(REGIMES, row, strict=True) if np.isfinite(v)}
                for name, row in zip(self.log.atoms.joint_names, self.regimes, strict=True)
            },
        }


def compare(log: Log, model: Model, library: Mapping[str, Effect]) -> Comparison:
    """Replay each part of the plant on what was measured. Raises UserError."""
    used = {e.effect: library[e.effect] for e in model.effects}
    evidence = gather(log, model, used, noise_of(log))
    fit = refit([evidence], (), never_given(model, evidence.atoms.effects), iterations=3)
    found = misfit(evidence, fit, 0)
    judged, point = {"drive": _drive_channels, "body": _body_channels, "effort": _effort_channels}, fit.points[0]
    channels = (channel for rest in evidence.rests(point) for channel in judged[rest.part.name](evidence, point, rest))
    return Comparison(evidence, fit, found, tuple(channels), regimes(evidence, fit))


def _drive_channels(log: RobotEvidence, point: Point, rest: Rest) -> list[Channel]:
    channels = []
    for c, signal in enumerate(DRIVE_CHANNELS):
        for j, joint in enumerate(log.atoms.joint_names):
            rows = log.drive.used[:, j, c] > 0
            if not rows.any():
                continue
            over, y = rest.residual[rows, j, c], log.drive.measured[rows, j, c]
            error = over * log.drive.floor[j, c]
            fit_percent = 100.0 * (1.0 - np.linalg.norm(error) / max(np.linalg.norm(y - y.mean()), 1e-12))
            rms = lambda x: float(np.sqrt((x**2).mean()))  # noqa: E731
            channels.append(Channel(f"{signal}/{joint}", rms(error), rms(over), fit_percent, whiteness(over)))
    return channels


def _body_channels(log: RobotEvidence, point: Point, rest: Rest) -> list[Channel]:
    sizes = rest.sizes(np.ones(log.blocks, bool))
    apart = max(round(2.0 * SMOOTHING / (DECIMATION * log.period)), 1)  # rows that share no noise through the filter
    channels = []
    for c, (name, over, floor) in enumerate(zip(log.body.channels, sizes, log.body.floor, strict=True)):
        if np.isfinite(over):
            white = whiteness(rest.residual[::apart, c], log.body.used[::apart, c])
            channels.append(Channel(name, float(over * floor), float(over), None, white))
    return channels


def _effort_channels(log: JointEvidence, point: Point, rest: Rest) -> list[Channel]:
    over = rest.residual[log.used > 0, 0, 0]
    size = float(np.sqrt((over**2).mean()))
    percent = log.fit_percent(point)
    return [Channel(f"applied_torque/{log.atoms.joint_names[0]}", size * log.floor, size, percent, whiteness(over))]


def whiteness(residual: np.ndarray, used: np.ndarray | None = None) -> float:
    """RMS autocorrelation over the first lags, relative to that of white noise: about 1 if white.

    residual (T,), zero on rows that do not count; used (T,): 1.0 on those that do (default: all).
    """
    used = np.ones(len(residual)) if used is None else used
    x = residual - used * residual.sum() / max(used.sum(), 1.0)
    energy = float(x @ x)
    if energy <= 0:
        return 1.0
    rho = np.array([x[:-k] @ x[k:] for k in range(1, WHITE_LAG + 1)]) / energy
    return float(np.sqrt((rho**2).mean() * used.sum()))
