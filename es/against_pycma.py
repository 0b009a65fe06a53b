"""`python -m es.against_pycma`: evaluations that this search and pycma need for the same target, side by side.

pycma (package `cma`, extra `test`) is Hansen's own implementation and shares no code with this one. Without bounds
both run CMA-ES with its default constants from the same start, so the counts should agree. With the optimum on a
bound there are two comparisons: against pycma with the paper's policy (redraw, then project and charge), where they
should agree too, and against pycma's own handlers, which let the mean leave the box and so need fewer evaluations.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import numpy as np

from es.search import SearchSettings, search
from es.space import Parameter, ParameterSpace
from es.stages import Stage

Cost = Callable[[np.ndarray], np.ndarray]

GENERATION_LIMIT = 3000


@dataclass(frozen=True)
class Problem:
    """A cost over a box, its start and its target; vectors in the box's units."""

    name: str
    cost: Cost = field(compare=False)  # (P, n) -> (P,), minimum 0 in the box
    size: int
    low: float
    high: float
    start: float
    sigma: float  # initial standard deviation as a share of the range
    target: float
    population: int
    bounded: bool = False  # the optimum lies on bounds


def sphere(x: np.ndarray) -> np.ndarray:
    """sum x^2."""
    return np.sum(x**2, axis=-1)


def rosenbrock(x: np.ndarray) -> np.ndarray:
    """A curved valley with its end at (1, ..., 1)."""
    return np.sum(100.0 * (x[..., 1:] - x[..., :-1] ** 2) ** 2 + (1.0 - x[..., :-1]) ** 2, axis=-1)


def rotated_ellipsoid(size: int) -> Cost:
    """sum 10^(6 (i-1)/(n-1)) (Q x)_i^2 with a fixed rotation Q: condition 1e6."""
    rotation = np.linalg.qr(np.random.default_rng(size).standard_normal((size, size)))[0]
    stiffness = 10.0 ** (6.0 * np.arange(size) / (size - 1))
    return lambda x: np.sum(stiffness * (x @ rotation) ** 2, axis=-1)


def sphere_beyond(size: int, active: int) -> Cost:
    """Distance squared from a point that lies 0.2 outside the box [0, 1]^n in `active` coordinates; minimum 0."""
    centre = np.where(np.arange(size) < active, 1.2, 0.4)
    return lambda x: np.sum((x - centre) ** 2, axis=-1) - active * 0.2**2


def problems(size: int) -> tuple[Problem, ...]:
    """The unbounded three; targets as low as float32 candidates can reliably tell apart."""
    population = 15 if size == 13 else 4 + int(3 * np.log(size))
    free = {"size": size, "low": -5.0, "high": 5.0, "population": population}
    return (
        Problem("sphere", sphere, start=1.0, sigma=0.05, target=1e-6, **free),
        Problem("ellipsoid", rotated_ellipsoid(size), start=1.0, sigma=0.05, target=1e-3, **free),
        Problem("rosenbrock", rosenbrock, start=0.0, sigma=0.05, target=1e-6, **free),
    )


def bounded_problem(size: int, active: int, target: float) -> Problem:
    """A sphere whose centre lies outside the unit box."""
    name, cost = f"sphere, {active} of {size} at a bound", sphere_beyond(size, active)
    return Problem(name, cost, size, 0.0, 1.0, 0.5, 0.25, target, 10, bounded=True)


class _Counter:
    """The cost with a count of evaluations; raises _Reached when the target is met."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.evaluations = problem, 0

    def __call__(self, x: np.ndarray) -> np.ndarray:
        costs = self.problem.cost(np.asarray(x, np.float64))
        self.evaluations += len(x)
        if np.min(costs) <= self.problem.target:
            raise _Reached
        return costs


class _Reached(Exception):
    pass


def evaluations_here(problem: Problem, seed: int) -> float:
    """Evaluations that `search` needs, to the end of the generation that reaches the target; inf if it does not."""
    space = ParameterSpace(
        tuple(Parameter(f"x{i}", "", problem.low, problem.high, problem.start) for i in range(problem.size))
    )
    settings = SearchSettings(problem.population, problem.sigma, tolerance=1e-7)
    count = _Counter(problem)
    try:
        stages = [Stage(problem.name, GENERATION_LIMIT)]
        search(lambda stage, x, key: (count(x), None), space, stages, settings, jax.random.key(seed))
    except _Reached:
        return count.evaluations
    return np.inf


def evaluations_pycma(problem: Problem, seed: int, policy: str = "none") -> float:
    """The same by pycma; `policy` for the bounds: none, redraw (the paper's), BoundTransform or BoundPenalty."""
    import cma

    options = {"popsize": problem.population, "seed": seed + 1, "verbose": -9, "maxiter": GENERATION_LIMIT}
    options |= {"tolfun": 0, "tolfunhist": 0, "tolx": 1e-12, "tolflatfitness": 1000}
    handlers = {"BoundTransform": cma.BoundTransform, "BoundPenalty": cma.BoundPenalty}
    if policy in handlers:
        options |= {"bounds": [problem.low, problem.high], "BoundaryHandler": handlers[policy]}
    start, sigma = np.full(problem.size, problem.start), problem.sigma * (problem.high - problem.low)
    strategy = cma.CMAEvolutionStrategy(start, sigma, options)
    count = _Counter(problem)
    try:
        while not strategy.stop():
            if policy == "redraw":
                told = _redrawn(strategy, problem)
                inside = np.clip(told, problem.low, problem.high)
                costs = count(inside) + SearchSettings().bound_penalty * np.linalg.norm(told - inside, axis=-1)
            else:
                told = np.array(strategy.ask())
                costs = count(told)
            strategy.tell(list(told), list(costs))
    except _Reached:
        return count.evaluations
    return np.inf


def _redrawn(strategy, problem: Problem, redraws: int = 1000) -> np.ndarray:
    """The paper's policy with pycma's samples: P vectors, inside unless 1 + 1000 draws for each were not enough."""
    found: list[np.ndarray] = []
    drawn: list[np.ndarray] = []
    while len(found) < problem.population and len(drawn) < (1 + redraws) * problem.population:
        batch = strategy.ask(5 * problem.population)
        found += [x for x in batch if np.all((x >= problem.low) & (x <= problem.high))]
        drawn += batch
    return np.array((found + drawn[::-1])[: problem.population])


def compare(problem: Problem, seeds: range, policies: tuple[str, ...]) -> dict[str, float]:
    """Median evaluations over seeds: here, and for each of pycma's policies."""
    medians = {"here": float(np.median([evaluations_here(problem, seed) for seed in seeds]))}
    for policy in policies:
        medians[policy] = float(np.median([evaluations_pycma(problem, seed, policy) for seed in seeds]))
    return medians


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=15, help="runs per entry, of which the median is shown")
    parser.add_argument("--sizes", type=int, nargs="*", default=[10, 13], help="numbers of parameters")
    arguments = parser.parse_args()
    seeds = range(arguments.seeds)
    print(f"median evaluations to the target over {arguments.seeds} seeds")
    print(f"{'problem':36s}{'target':>8s}{'here':>8s}  pycma (ratio here / pycma)")
    for size in arguments.sizes:
        for problem in problems(size):
            _print_row(problem, compare(problem, seeds, ("none",)))
        for active, target in ((1, 1e-2), (1, 1e-4), (3, 1e-2), (3, 1e-4)):
            problem = bounded_problem(size, active, target)
            _print_row(problem, compare(problem, seeds, ("redraw", "BoundTransform", "BoundPenalty")))


def _print_row(problem: Problem, medians: dict[str, float]) -> None:
    here = medians.pop("here")
    name = problem.name if problem.bounded else f"{problem.name}, n = {problem.size}"
    theirs = ", ".join(f"{policy} {count:.0f} ({here / count:.2f})" for policy, count in medians.items())
    print(f"{name:36s}{problem.target:8.0e}{here:8.0f}  {theirs}", flush=True)


if __name__ == "__main__":
    main()
