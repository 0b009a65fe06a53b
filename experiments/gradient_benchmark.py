"""CMA-ES, gradients, and both one after the other: true cost over equal wall time, from the same start.

Every method gets programs that are compiled already; how long that took is told beside the result. The task is searched
in its last stage at once, with that stage's drive train, senses and trials, from its initial guess.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np

from es import RefineSettings, SearchSettings, Stage, refine, search
from experiments.refinement import TrueCost
from experiments.tune import StagedEvaluation, TuneOptions

ENDLESS = 1_000_000


class OutOfTime(Exception):
    """The clock has run down in the middle of a method."""


class Course(NamedTuple):
    """One run of one method."""

    method: str
    seed: int
    cost: float  # best true cost at the end
    evaluations: int  # of the true cost
    slopes: int
    seconds: list[float]  # when the best cost fell
    costs: list[float]  # to what


@dataclass
class Clock:
    """The true cost with a stop watch: raises OutOfTime once the time is over, remembers when the best fell."""

    cost: TrueCost
    limit: float

    def __post_init__(self) -> None:
        self.begun, self.best, self.values = time.monotonic(), np.inf, None
        self.evaluations = self.slopes = 0
        self.course: list[tuple[float, float]] = []
        self.until = self.limit

    def elapsed(self) -> float:
        return time.monotonic() - self.begun

    def costs(self, candidates: np.ndarray) -> np.ndarray:
        if self.elapsed() > self.until:
            raise OutOfTime
        found = self.cost.costs(candidates)
        self.evaluations += len(candidates)
        best = int(np.argmin(found))
        if found[best] < self.best:
            self.best, self.values = float(found[best]), candidates[best]
            self.course.append((self.elapsed(), self.best))
        return found

    def slope(self, values: np.ndarray, step: int) -> np.ndarray:
        self.slopes += 1
        return self.cost.slope(values, step)


def compare(
    options: TuneOptions, seconds: float, seeds: int, tell: Callable[[str], None]
) -> tuple[dict[str, Any], list[Course]]:
    """All methods, with so many seeds each: (summary, courses)."""
    settings = RefineSettings(steps=ENDLESS, patience=ENDLESS)
    cost = TrueCost(StagedEvaluation(options), settings.population)
    space = options.definition.space()
    compiled = _time_of_each(cost, space.initial, settings.population)  # the first time includes compiling
    tell(f"compiled: true cost {compiled[0]:.0f} s, slopes {compiled[1]:.0f} s")
    each = _time_of_each(cost, space.initial, settings.population)
    courses = []
    for seed in range(seeds):
        cost.seed = seed
        for method, run in METHODS.items():
            clock = Clock(cost, seconds)
            run(clock, options, settings, seed)
            course = Course(method, seed, clock.best, clock.evaluations, clock.slopes, *map(list, zip(*clock.course)))
            tell(f"{method}, seed {seed}: {course.cost:.3f} ({course.evaluations} rollouts, {course.slopes} slopes)")
            courses.append(course)
    methods = {m: sorted(c.cost for c in courses if c.method == m) for m in METHODS}
    summary = {
        "task": options.definition.task,
        "seconds": seconds,
        "start": float(cost.costs(np.repeat(space.initial[None], settings.population, 0))[0]),
        "compile_seconds": {"cost": compiled[0], "slope": compiled[1]},
        "seconds_each": {"cost_of_16": each[0], "slope": each[1]},
        "cost": {m: {"median": float(np.median(v)), "all": v} for m, v in methods.items()},
    }
    return summary, courses


def _time_of_each(cost: TrueCost, values: np.ndarray, population: int) -> tuple[float, float]:
    """Seconds of a batch of true costs, and of one slope."""
    begun = time.monotonic()
    cost.costs(np.repeat(values[None], population, 0))
    between = time.monotonic()
    cost.slope(values, 0)
    return between - begun, time.monotonic() - between


def _cma_es(clock: Clock, options: TuneOptions, settings: RefineSettings, seed: int) -> None:
    definition = options.definition
    try:
        search(
            lambda stage, candidates, key: (clock.costs(candidates), None),
            definition.space(),
            [Stage("the whole", ENDLESS)],
            SearchSettings(population=settings.population, sigma=definition.sigma),
            jax.random.key(seed),
        )
    except OutOfTime:
        return


def _gradients(clock: Clock, options: TuneOptions, settings: RefineSettings, seed: int) -> None:
    start = options.definition.space().initial if clock.values is None else clock.values
    try:
        refine(clock.slope, clock.costs, options.definition.space(), start, settings)
    except OutOfTime:
        return


def _both(clock: Clock, options: TuneOptions, settings: RefineSettings, seed: int) -> None:
    """Half of the time each."""
    clock.until = 0.5 * clock.limit
    _cma_es(clock, options, settings, seed)
    clock.until = clock.limit
    _gradients(clock, options, settings, seed)


METHODS = {"CMA-ES": _cma_es, "gradients": _gradients, "CMA-ES, then gradients": _both}
