"""Motions that make a robot show its drives: legs in the air, all joints at once, within the joints' limits."""

from typing import NamedTuple

import numpy as np

DURATION = 8.0  # s
MARGIN = 0.15  # rad kept from the joints' ends
FASTEST = 4.0  # rad/s, half of what the drives can do
TONES = 8
RAMP = 0.5  # s in which a motion swells from rest and dies down again
HOLD, MOVE = 0.6, 0.2  # s of a staircase


class Excitation(NamedTuple):
    """A named course of joint positions (T, J), rad, on the control's ticks."""

    name: str
    position: np.ndarray


def excitations(limits: np.ndarray, rest: np.ndarray, period: float, seed: int = 0) -> list[Excitation]:
    """Courses that differ in speed, size and pauses; limits (J, 2) rad, rest (J,) rad the pose to move about."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(DURATION / period)) * period
    bands = {
        "slow and large (0.1 to 0.6 Hz)": (0.1, 0.6, 0.9),
        "broad (0.2 to 5 Hz)": (0.2, 5.0, 0.6),
        "fast and small (3 to 10 Hz)": (3.0, 10.0, 0.3),
    }
    reach = np.minimum(limits[:, 1] - rest, rest - limits[:, 0]) - MARGIN
    reach = np.clip(reach, 0.05, 1.0)
    swell = np.clip(np.minimum(time, time[-1] - time) / RAMP, 0.0, 1.0)[:, None]
    found = []
    for name, (low, high, share) in bands.items():
        course = _tones(time, low, high, len(rest), rng)
        found.append(Excitation(name, rest + swell * _limited(course, share * reach, period)))
    found.append(
        Excitation("steps with pauses", rest + swell * _limited(_staircase(time, len(rest), rng), 0.8 * reach, period))
    )
    return found


def _tones(time: np.ndarray, low: float, high: float, joints: int, rng: np.random.Generator) -> np.ndarray:
    """Sums of TONES sines with frequencies of their own for each joint, (T, J)."""
    edges = np.geomspace(low, high, TONES + 1)
    frequency = edges[:-1] * (edges[1:] / edges[:-1]) ** rng.uniform(size=(joints, TONES))
    phase = rng.uniform(0.0, 2.0 * np.pi, (joints, TONES))
    return (np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase) / frequency).sum(-1)


def _staircase(time: np.ndarray, joints: int, rng: np.random.Generator) -> np.ndarray:
    """Random levels, each held after a smooth move, (T, J)."""
    step = (time / (HOLD + MOVE)).astype(int)
    levels = rng.uniform(-1.0, 1.0, (step[-1] + 2, joints))
    part = np.clip((time - step * (HOLD + MOVE)) / MOVE, 0.0, 1.0)
    way = (0.5 - 0.5 * np.cos(np.pi * part))[:, None]
    return levels[step] + way * (levels[step + 1] - levels[step])


def _limited(course: np.ndarray, reach: np.ndarray, period: float) -> np.ndarray:
    """Scaled to reach (J,) at most, less where it would be too fast."""
    course = course / np.maximum(np.abs(course).max(0), 1e-9) * reach
    speed = np.abs(np.gradient(course, period, axis=0)).max(0)
    return course * np.minimum(1.0, FASTEST / np.maximum(speed, 1e-9))
