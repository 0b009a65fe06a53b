"""Where a torque ripple of a rigid joint may have its lines: the error has one narrow valley per harmonic."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from experiments.effects.effect import Effect
from experiments.measurement.evidence.joint_replay import JointLog

PERIODS = np.geomspace(3.0, 300.0, 500)  # over the joint's travel
LINES = 3


def with_ripple_seeds(
    effects: Mapping[str, Effect], log: JointLog, residual: np.ndarray, travel: float, stride: int
) -> dict[str, Effect]:
    """The effects, torque_ripple's harmonic starting at the strongest lines of a residual (T,) over the position."""
    if "torque_ripple" not in effects:
        return dict(effects)
    row = slice(None, None, stride)
    effort, position = log.effort[row].astype(float), log.position[row].astype(float)
    ordinary = [effort, log.acceleration[row], log.velocity[row], np.sign(log.velocity[row]), np.sin(position)]
    basis, _ = np.linalg.qr(np.stack([np.ones_like(effort), *ordinary], 1))
    rest = _without(basis, residual[row].astype(float))
    scale = 2.0 * np.pi / travel
    gains = np.array([_gain(basis, rest, effort, n * scale * position) for n in PERIODS])
    peaks = np.flatnonzero((gains >= np.roll(gains, 1)) & (gains >= np.roll(gains, -1)))
    best = [float(PERIODS[i] * scale) for i in peaks[np.argsort(gains[peaks])[::-1]][:LINES]]
    ripple = effects["torque_ripple"]
    limits = {"low": float(PERIODS[0] * scale), "high": float(PERIODS[-1] * scale), "start": best[0]}
    parameters = tuple(dataclasses.replace(p, **limits) if p.role == "shape" else p for p in ripple.parameters)
    seeds = tuple({"harmonic": harmonic} for harmonic in best)
    return {**effects, "torque_ripple": dataclasses.replace(ripple, parameters=parameters, seeds=seeds)}


def _gain(basis: np.ndarray, rest: np.ndarray, effort: np.ndarray, angle: np.ndarray) -> float:
    """Share of the rest that a ripple at this angle explains."""
    waves = [wave * of for of in (effort, np.ones_like(effort)) for wave in (np.sin(angle), np.cos(angle))]
    lines = np.stack([_without(basis, wave) for wave in waves], 1)
    solution, *_ = np.linalg.lstsq(lines, rest, rcond=None)
    return float(((lines @ solution) ** 2).sum())


def _without(basis: np.ndarray, x: np.ndarray) -> np.ndarray:
    return x - basis @ (basis.T @ x)
