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
from experiments.measurement.fits.fit_types import Refitted
from experiments.measurement.fits.misfit import FLOOR, Misfit, misfit
from experiments.measurement.fits.nominal import never_given
from experiments.measurement.fits.refit import refit
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.noise_floor import noise_of
from experiments.model import Model

EXPLAINED = 1.3 * FLOOR  # residual over noise of the worst of many channels of a right model
STILL, FAST = 0.05, 1.0  # rad/s of the joint
LOADED = 0.5  # of the largest torque of the joint
REVERSAL = 0.05  # s around a change of the joint's direction
FEW = 20  # rows: a regime with fewer is not judged
WHITE_LAG = 10  # rows over which the residual's autocorrelation is judged
REGIMES = ("still", "slow", "fast", "loaded", "reversing", "position mode", "torque mode")


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

    log: Evidence | JointEvidence
    fit: Refitted
    misfit: Misfit
    channels: tuple[Channel, ...]
    regimes: np.ndarray | None  # (joints, REGIMES) residual over noise of the drive, NaN where there is no such row

    @property
    def worst(self) -> Channel:
        return max(self.channels, key=lambda c: c.over_noise)

    @property
    def explained(self) -> bool:
        return all(c.over_noise <= EXPLAINED for c in self.channels)

    def in_words(self) -> str:
        """The comparison in one or two sentences."""
        return " ".join(filter(None, (self._verdict(), self.log.not_judged)))

    def _verdict(self) -> str:
        name, worst = self.log.name, self.worst
        at = f"{worst.name}: {worst.over_noise:.2f} times the noise"
        if self.explained:
            return f"The model explains {name} down to the sensors' noise; worst is {at}."
        failing = [c for c in self.channels if c.over_noise > EXPLAINED]
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
    if isinstance(evidence, JointEvidence):
        return Comparison(evidence, fit, found, (_effort_channel(evidence, fit),), regimes(evidence, fit))
    channels = (*_drive_channels(evidence, fit), *_body_channels(evidence, found, fit))
    return Comparison(evidence, fit, found, channels, regimes(evidence, fit))


def _drive_channels(log: Evidence, fit: Refitted) -> list[Channel]:
    if log.drive is None:
        return []
    residual = log.drive_residual([fit.points[0]])[0]
    channels = []
    for c, signal in enumerate(DRIVE_CHANNELS):
        for j, joint in enumerate(log.atoms.joint_names):
            rows = log.drive.used[:, j, c] > 0
            if not rows.any():
                continue
            over, y = residual[rows, j, c], log.drive.measured[rows, j, c]
            error = over * log.drive.floor[j, c]
            fit_percent = 100.0 * (1.0 - np.linalg.norm(error) / max(np.linalg.norm(y - y.mean()), 1e-12))
            rms = lambda x: float(np.sqrt((x**2).mean()))  # noqa: E731
            channels.append(Channel(f"{signal}/{joint}", rms(error), rms(over), fit_percent, whiteness(over)))
    return channels


def _body_channels(log: Evidence, found: Misfit, fit: Refitted) -> list[Channel]:
    if log.body is None:
        return []
    residual = log.body_residual([fit.points[0]])[0]
    apart = max(round(2.0 * SMOOTHING / (DECIMATION * log.period)), 1)  # rows that share no noise through the filter
    channels = []
    for c, (name, over, floor) in enumerate(zip(log.body.channels, found.body, log.body.floor, strict=True)):
        if np.isfinite(over):
            white = whiteness(residual[::apart, c], log.body.used[::apart, c])
            channels.append(Channel(name, float(over * floor), float(over), None, white))
    return channels


def _effort_channel(log: JointEvidence, fit: Refitted) -> Channel:
    over = log.residual([fit.points[0]])[0]
    over = over[log.used > 0]
    size = float(np.sqrt((over**2).mean()))
    percent = log.fit_percent(fit.points[0])
    return Channel(f"applied_torque/{log.atoms.joint_names[0]}", size * log.floor, size, percent, whiteness(over))


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


def regimes(log: Evidence | JointEvidence, fit: Refitted, index: int = 0) -> np.ndarray | None:
    """Residual over noise (joints, REGIMES) of the index-th log of a fit; None where no drive was measured."""
    if isinstance(log, JointEvidence):
        return _joint_regimes(log, fit.points[index])
    if log.drive is None:
        return None
    r = np.sqrt((log.drive_residual([fit.points[index]])[0] ** 2).mean(2))
    d, rows = log.drive.log, log.drive.rows
    motion = _motion_regimes(d.joint_velocity[:rows], d.joint_torque[:rows], log.period, 1.0)
    mode = d.position_mode[:rows]
    return _by_regime(r, (*motion, mode > 0.5, mode < 0.5))


def _joint_regimes(log: JointEvidence, point: Point) -> np.ndarray:
    """The same for a rigid joint, its speeds counted from its own largest one; it has no modes."""
    r = np.abs(log.residual([point]))
    v = log.filter.thinned(log.log.velocity[None])
    never = np.zeros_like(r.T, bool)
    unit = float(np.abs(v).max()) / (2.0 * FAST)
    motion = _motion_regimes(v.T, log.measured()[:, None], log.period * log.filter.stride, unit)
    return _by_regime(r.T, (*motion, never, never))


def _motion_regimes(v: np.ndarray, tau: np.ndarray, period: float, unit: float) -> tuple[np.ndarray, ...]:
    """Masks (T, J): still, slow, fast, loaded, reversing; thresholds of speed in units of `unit`."""
    turning = np.zeros_like(v, bool)
    speed = np.abs(v) / unit
    moving = np.sign(np.where(speed > STILL, v, 0.0))
    turning[1:] = moving[1:] * moving[:-1] < 0
    kernel = np.ones(2 * max(round(REVERSAL / period), 1) + 1)
    turning = np.stack([np.convolve(column, kernel, "same") > 0 for column in turning.T.astype(float)], 1)
    loaded = np.abs(tau) > LOADED * np.abs(tau).max(0)
    return speed < STILL, (speed >= STILL) & (speed < FAST), speed >= FAST, loaded, turning


def _by_regime(r: np.ndarray, masks: tuple[np.ndarray, ...]) -> np.ndarray:
    """RMS of r (T, J) on each mask: (J, masks), NaN where it has hardly a row."""
    table = np.full((r.shape[1], len(masks)), np.nan)
    for k, chosen in enumerate(masks):
        count = chosen.sum(0)
        table[:, k] = np.where(count > FEW, np.sqrt((r**2 * chosen).sum(0) / np.maximum(count, 1)), np.nan)
    return table
