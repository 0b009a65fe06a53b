"""Commands for legs in the air: position courses within the joints' ranges and speed, rich, fast or poor."""

import numpy as np

from experiments.independent_plant.numbers import KINDS, MIRROR, Array, numbers_file

TICK = 2.5e-3  # s
MARGIN = 0.12  # rad kept to the ends of the joint's range: the soft position law overshoots
SPEED_MARGIN = 0.8  # of the gear's speed limit, in fast motions
SPEED = {"rich": 6.0, "poor": 0.15}  # rad/s, peak
COURSES = ("sines", "chirp", "steps")


def fade(time: Array) -> Array:
    """0 to 1 smoothly over the first half second, so that a course starts from rest."""
    x = np.clip(time / 0.5, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def sines(time: Array, rng: np.random.Generator, low: float, high: float, count: int) -> Array:
    frequency = np.exp(rng.uniform(np.log(low), np.log(high), count))
    amplitude, phase = rng.uniform(0.5, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    return (amplitude * np.sin(2.0 * np.pi * frequency * time[:, None] + phase)).sum(axis=1)


def _chirp(time: Array, rng: np.random.Generator, low: float, high: float) -> Array:
    span = time[-1] + TICK
    phase = 2.0 * np.pi * (low * time + 0.5 * (high - low) * time**2 / span) + rng.uniform(0.0, 2.0 * np.pi)
    return np.sin(phase)


def _steps(time: Array, rng: np.random.Generator, hold: float, rise: float) -> Array:
    """Levels held for about `hold` s, each reached along a smooth ramp of `rise` s."""
    count = int(time[-1] / hold) + 2
    levels = np.concatenate([[0.0], rng.uniform(-1.0, 1.0, count)])
    step = np.minimum((time / hold).astype(int), count - 1)
    x = np.clip((time - step * hold) / rise, 0.0, 1.0)
    x = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return levels[step] + (levels[step + 1] - levels[step]) * x


def air_course(duration: float, richness: str, rng: np.random.Generator) -> Array:
    """Joint positions (T, 12), rad. `richness` is `rich`, `fast` (up to the limits) or `poor` (slow only)."""
    time = np.arange(round(duration / TICK)) * TICK
    courses = np.empty((len(time), 12))
    top = SPEED_MARGIN * numbers_file()["loops"]["gear_speed_limit"]
    for joint in range(12):
        kind = KINDS[joint % 3]
        low, high = numbers_file()["joint_limits_LF"][kind]
        middle, reach = 0.5 * (low + high), 0.5 * (high - low) - MARGIN
        if kind == "HFE":  # the thigh hangs a little back, as it would over its foot
            middle, reach = 0.8, 0.4
        if richness == "poor":
            shape, speed = sines(time, rng, 0.03, 0.1, 2), SPEED["poor"]
        elif richness == "fast":
            best = top / (2.0 * np.pi * reach)  # Hz, of a sine of full reach at full speed
            shape, speed = _chirp(time, rng, 0.4 * best, 1.1 * best), top
        else:
            course, speed = COURSES[rng.choice(3, p=[0.6, 0.2, 0.2])], SPEED["rich"]
            if course == "sines":
                shape = sines(time, rng, 0.3, 3.0, 5)
            elif course == "chirp":
                shape = _chirp(time, rng, 0.3, 3.0)
            else:
                shape = _steps(time, rng, rng.uniform(0.5, 0.8), rng.uniform(0.12, 0.2))
        shape = fade(time) * shape
        rate = np.abs(np.diff(shape)).max() / TICK
        size = min(reach / np.abs(shape).max(), speed / rate)
        courses[:, joint] = MIRROR[joint] * (middle + size * shape)
    return courses
