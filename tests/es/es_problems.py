"""Small searches that several test files use."""

import numpy as np

import es

# One pair for all files: each other pair compiles for seconds. 12 candidates split over 1, 2 and 4 devices.
POPULATION, SIZE = 12, 4
SETTINGS = es.SearchSettings(population=POPULATION)


def space(initial: float = 0.5, low: float = -1.0, high: float = 2.0) -> es.ParameterSpace:
    """A box of equal ranges."""
    return es.ParameterSpace(tuple(es.Parameter(f"p{i}", "m", low, high, initial) for i in range(SIZE)))


def distance_squared(stage: es.Stage, x: np.ndarray, key) -> tuple[np.ndarray, None]:
    """Cost of a stage whose key is the optimum's coordinate."""
    return np.sum((x - stage.key) ** 2, axis=-1), None


TWO_STAGES = (es.Stage("loose", 6, key=0.2), es.Stage("full", 6, key=0.9, sigma_rescale=0.8, sigma_floor=0.3))


def same_result(a: es.SearchResult, b: es.SearchResult) -> bool:
    """Equal to the bit in everything but where it was resumed."""
    return (
        a.best.tobytes() == b.best.tobytes()
        and a.mean.tobytes() == b.mean.tobytes()
        and a.best_cost == b.best_cost
        and a.evaluations == b.evaluations
        and len(a.history) == len(b.history)
        and all(
            np.asarray(left).tobytes() == np.asarray(right).tobytes()
            for one, other in zip(a.history, b.history)
            for left, right in zip(one, other)
        )
    )
