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


def _course(time: Array, low: float, high: float, richness: str, rng: np.random.Generator) -> Array:
    """One joint's course from the middle of its range, `rich`, `fast` (up to the speed limit) or `poor` (slow)."""
    middle, reach = 0.5 * (low + high), 0.5 * (high - low)
    period = time[1] - time[0]
    top = SPEED_MARGIN * numbers_file()["loops"]["gear_speed_limit"]
    if richness == "poor":
        shape, speed = sines(time, rng, 0.03, 0.1, 2), SPEED["poor"]
    elif richness == "fast":
        best = top / (2.0 * np.pi * reach)  # Hz, of a sine of full reach at full speed
        shape, speed = _chirp(time, rng, 0.4 * best, 1.1 * best), top
    else:
        kind, speed = COURSES[rng.choice(3, p=[0.6, 0.2, 0.2])], SPEED["rich"]
        if kind == "sines":
            shape = sines(time, rng, 0.3, 3.0, 5)
        elif kind == "chirp":
            shape = _chirp(time, rng, 0.3, 3.0)
        else:
            shape = _steps(time, rng, rng.uniform(0.5, 0.8), rng.uniform(0.12, 0.2))
    shape = fade(time) * shape
    rate = np.abs(np.diff(shape)).max() / period
    return middle + shape * min(reach / np.abs(shape).max(), speed / rate)


def _range(kind: str) -> tuple[float, float]:
    """The angles that a course may use, on the left fore leg."""
    if kind == "rigid":
        return -1.2, 1.2
    if kind == "HFE":  # the thigh hangs a little back, as it would over its foot
        return 0.4, 1.2
    low, high = numbers_file()["joint_limits_LF"][kind]
    return low + MARGIN, high - MARGIN


def air_course(duration: float, richness: str, rng: np.random.Generator) -> Array:
    """Positions of all joints (T, 12), rad."""
    time = np.arange(round(duration / TICK)) * TICK
    legs = [[_course(time, *_range(kind), richness, rng) for kind in KINDS] for _ in range(4)]
    return MIRROR * np.array(legs).reshape(12, -1).T


def bench_course(duration: float, kind: str, richness: str, rng: np.random.Generator, period: float = TICK) -> Array:
    """Positions of one joint (T,), rad; `kind` is a joint kind or `rigid`."""
    return _course(np.arange(round(duration / period)) * period, *_range(kind), richness, rng)
