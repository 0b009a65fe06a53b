"""What thousands of trials say: success with its interval, which perturbation matters, survival over a disturbance."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import stats

CONFIDENCE = 0.95
BINS = 10  # of equal count for the ranking, of equal width for the curves
FEWEST_PER_BIN = 5  # below this a rank test says nothing
RESAMPLES = 2000


def success_interval(successes: int, trials: int) -> tuple[float, float]:
    """Clopper-Pearson interval of the success rate: it holds at least 95 % of the time, at 0 and 100 % too."""
    interval = stats.binomtest(successes, trials).proportion_ci(CONFIDENCE, method="exact")
    return float(interval.low), float(interval.high)


class Influence(NamedTuple):
    """How much one perturbation decides the cost."""

    share: float  # of the variance of the cost's rank that this perturbation explains alone, 0 to 1
    direction: float  # Spearman's rank correlation with the cost: > 0, more of it makes the motion worse
    p_value: float  # of the share being chance (Kruskal and Wallis)


def influence(values: np.ndarray, cost: np.ndarray) -> Influence | None:
    """Given-data first-order sensitivity of the cost (N,) to drawn values (N,); None where there is nothing to say.

    The trials are split into bins of equal count by the value; Kruskal and Wallis's H over the bins, corrected for
    chance, is the share of rank variance between bins (Tomczak and Tomczak 2014). It sees what a correlation cannot:
    that pushes to either side are bad.
    """
    bins = min(BINS, len(values) // FEWEST_PER_BIN)
    if bins < 2 or np.ptp(values) == 0 or np.ptp(cost) == 0:
        return None
    order = np.argsort(values, kind="stable")
    test = stats.kruskal(*(cost[part] for part in np.array_split(order, bins)))
    share = (test.statistic - bins + 1) / (len(values) - bins)
    return Influence(
        float(np.clip(share, 0.0, 1.0)), float(stats.spearmanr(values, cost).statistic), float(test.pvalue)
    )


class Survival(NamedTuple):
    """Success over the size of one disturbance; every array (bins,) but edges (bins + 1,)."""

    edges: np.ndarray
    trials: np.ndarray
    successes: np.ndarray
    low: np.ndarray  # 95 % interval; 0 to 1 in an empty bin
    high: np.ndarray


def survival(values: np.ndarray, success: np.ndarray, bins: int = BINS) -> Survival:
    """Success rate in bins of equal width of a disturbance (N,)."""
    edges = np.histogram_bin_edges(values, bins)
    trials, _ = np.histogram(values, edges)
    successes, _ = np.histogram(values[success > 0.5], edges)
    pairs = [success_interval(int(k), int(n)) if n else (0.0, 1.0) for k, n in zip(successes, trials, strict=True)]
    low, high = np.transpose(pairs)
    return Survival(edges, trials, successes, low, high)


def dependence(trials: np.ndarray, successes: np.ndarray) -> float:
    """p value of success being the same in all bins (bins,): small where the disturbance matters (chi square)."""
    seen = trials > 0
    table = np.stack([successes[seen], (trials - successes)[seen]])
    if table.shape[1] < 2 or (table.sum(1) == 0).any():
        return 1.0
    return float(stats.chi2_contingency(table).pvalue)


class Distribution(NamedTuple):
    """How a figure spreads over the trials."""

    mean: float
    std: float
    low: float
    p05: float
    p50: float
    p95: float
    high: float


def distribution(values: np.ndarray) -> Distribution:
    """Of values (N,)."""
    x = np.asarray(values, float)
    p05, p50, p95 = np.quantile(x, [0.05, 0.5, 0.95])
    return Distribution(*(float(v) for v in (x.mean(), x.std(), x.min(), p05, p50, p95, x.max())))


class Difference(NamedTuple):
    """How much a figure of one motion differs from another's on the same trials; below zero: it is smaller."""

    value: float
    low: float  # 95 % interval
    high: float


def paired_difference(before: np.ndarray, after: np.ndarray, statistic: Callable[[np.ndarray], float]) -> Difference:
    """`statistic` of costs `after` (N,) minus that of `before` (N,), trial by trial the same; percentile bootstrap."""
    rows = np.random.default_rng(0).integers(len(before), size=(RESAMPLES, len(before)))
    drawn = [statistic(after[row]) - statistic(before[row]) for row in rows]
    low, high = np.quantile(drawn, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2])
    return Difference(float(statistic(after) - statistic(before)), float(low), float(high))
