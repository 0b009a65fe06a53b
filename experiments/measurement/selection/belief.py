"""When an effect is believed: proven on blocks that its fit has not seen, told from none and from simpler ones."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.stats

from experiments.effects.effect import Effect
from experiments.effects.places import mask
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Masks, Refitted
from experiments.measurement.fits.footprint import left_at, noise_at
from experiments.measurement.selection.linear_score import Scored

CLEAR_GAIN = 300.0  # linear score that makes an effect worth a try
LEAST_GAIN = 40.0  # of chi^2 on held-out blocks: a chance of 1e-8 for one hypothesis, and there are a thousand
LEAST_SHARE = 0.01  # of the affected channels' noise variance: below this a model of a real robot is right
LEAST_STEP = 0.2  # of what is left over the noise where an effect acts: one that takes less is not what is missing
TIE = 0.25  # of what the winner leaves over the noise, or takes away: a rival that is closer cannot be told from it
SLIGHT = 0.01  # of what the best explains: a simpler one that explains the log to the noise may explain so much less
MOST = 0.5  # of what is left where an effect acts
NOTHING = 4.0  # of chi^2, by which joints differ that do not feel an effect
COVERAGE, CONFIDENCE = 1.96, 0.95  # standard deviations to each side that an interval reaches, and what it holds
# of a parameter, standard deviation: with a quarter of it, a fifth of 85 intervals on the second plant held no truth
OWN_ERROR = 0.01
NEAR_END = 1e-3  # of a bound: a fit that ends there wanted to go on
SURELY = 1e-9  # of a strength: a smaller spread says no more
LEAST_SPREAD = 1e-150  # whose square is a number yet
DEGENERATE = 1e-6  # of the largest variance: less is rounding


def interval(fit: Refitted, k: int, value: float) -> tuple[float, float]:
    """95 % interval of the k-th parameter of a fit's effects: what the log tells, and what the model's own steps and
    laws may be wrong by, which no log tells."""
    half = COVERAGE * float(np.hypot(np.sqrt(max(fit.covariance[k, k], 0.0)), OWN_ERROR * value))
    return value - half, value + half


class Finalist(NamedTuple):
    """A refitted hypothesis; chi^2 on the blocks it was not fitted to."""

    scored: Scored
    fit: Refitted
    held_out: float


def told_from_none(effect: Effect, fit: Refitted, k: int = -1) -> bool:
    """Whether a fit tells its k-th effect from none: not where the 95 % region of its strengths holds zero, nor where
    the interval of a shape does without which there is no effect (a speed, a width)."""
    values = fit.effects[k].parameters
    first = sum(len(placed.parameters) for placed in fit.effects[: k % len(fit.effects)])
    its = slice(first, first + len(values))
    covariance = fit.covariance[its, its]
    spread = dict(zip(values, np.sqrt(np.maximum(np.diag(covariance), 0.0)), strict=True))
    shapes = [p.name for p in effect.parameters if p.role == "shape" and p.low > 0]
    if any(abs(values[name]) <= COVERAGE * spread[name] for name in shapes):
        return False
    names = {p.name for p in effect.strengths}
    here = [name in names for name in values]
    strengths = np.array([value for name, value in values.items() if name in names])
    distance = _distance(strengths, covariance[np.ix_(here, here)])
    return bool(distance > scipy.stats.chi2.ppf(CONFIDENCE, len(strengths)))


def at_end_of_shape(effect: Effect, fit: Refitted) -> bool:
    """Whether a shape of a fit's last effect without which there is none stands at its end: the law is another one."""
    values = fit.effects[-1].parameters
    shapes = [p for p in effect.parameters if p.role == "shape" and p.low > 0]
    return any(not p.low * (1.0 + NEAR_END) < values[p.name] < p.high * (1.0 - NEAR_END) for p in shapes)


def _distance(x: np.ndarray, covariance: np.ndarray) -> float:
    """Squared Mahalanobis distance of x (n,) from zero, also where of two strengths only the sum is known."""
    least = np.maximum(SURELY * np.abs(x), LEAST_SPREAD)  # a spread of zero, too, is a distance
    scale = np.maximum(np.sqrt(np.maximum(np.diag(covariance), 0.0)), least)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    along = vectors.T @ (x / scale)
    return float((along**2 / np.maximum(values, DEGENERATE)).sum())


def simplest(
    finalists: list[Finalist], before: float, noise: float, joint_names: tuple[str, ...]
) -> tuple[Finalist, list[Finalist]]:
    """Of those that the held-out blocks cannot tell from the best, the one with the fewest parameters, and its rivals.

    A rival with more parameters is no rival: an effect that holds another as its limit always fits as well. Nor is the
    winner at another place: where joints do not feel an effect, the one with the fewest joints is what was seen.
    """
    best = finalists[0].held_out
    reach = max(TIE * min(best - noise, before - best), LEAST_GAIN)
    # nothing is better than noise; but a weak effect is little beside what the noise may be wrong by in all channels
    enough = max(best + reach, min(noise, best + SLIGHT * (before - best)))
    close = [f for f in finalists if f.held_out <= enough]
    fewest = min(len(f.scored.effect.parameters) for f in close)
    simple = [f for f in close if len(f.scored.effect.parameters) == fewest]
    effect = simple[0].scored.effect
    alike = [f for f in simple if f.scored.effect is effect and f.held_out - simple[0].held_out < NOTHING]
    winner = min(alike, key=lambda f: mask(f.scored.where, effect.axis, joint_names).sum())
    return winner, [f for f in simple if not any(f is one for one in alike)]


def plain(effect: Effect, where: str, before: Refitted, after: float, logs: Sequence[Evidence], test: Masks) -> bool:
    """Whether an effect explains most of what is left where it acts, and that is more than noise.

    Then its interval need not hold it apart from none: a misfit elsewhere may have widened that, through nominal
    numbers that act on both.
    """
    gain = chi2_on(before, test) - after
    return gain > max(noise_at(effect, where, logs, test), MOST * left_at(effect, where, logs, before, test))


def loud(effect: Effect, where: str, before: Refitted, logs: Sequence[Evidence], test: Masks) -> bool:
    """Whether as much is left where an effect acts as its noise."""
    return left_at(effect, where, logs, before, test) > noise_at(effect, where, logs, test)


def proven(effect: Effect, where: str, before: Refitted, after: float, logs: Sequence[Evidence], test: Masks) -> bool:
    """Whether the fall of chi^2 on held-out blocks says that the effect is there."""
    affected = noise_at(effect, where, logs, test)
    left = left_at(effect, where, logs, before, test)
    return chi2_on(before, test) - after > max(LEAST_GAIN, LEAST_SHARE * affected, LEAST_STEP * left)


def halves(logs: Sequence[Evidence]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Alternate pairs of blocks: fitted on one half, proven on the other."""
    train = [np.arange(log.blocks) // 2 % 2 == 0 if log.blocks > 3 else np.arange(log.blocks) % 2 == 0 for log in logs]
    return train, [~mask_ for mask_ in train]


def all_blocks(logs: Sequence[Evidence]) -> list[np.ndarray]:
    """Every block of every log."""
    return [np.ones(log.blocks, bool) for log in logs]


def weight_of(logs: Sequence[Evidence], blocks: Masks) -> float:
    """Expected chi^2 of noise alone."""
    return float(sum((log.weight() * b).sum() for log, b in zip(logs, blocks, strict=True)))


def chi2_on(fit: Refitted, blocks: Masks) -> float:
    """chi^2 that a fit leaves on some blocks (masks per log)."""
    return float(sum((c * b).sum() for c, b in zip(fit.chi2, blocks, strict=True)))
