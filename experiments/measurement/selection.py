"""Selection: score every hypothesis, refit the best in the simulator, keep what held-out blocks prove.

One effect at a time. The linear score of every effect at every place, with the robot's nominal numbers projected out,
proposes; the non-linear refit on half of the blocks and its error on the other half decide.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from experiments.effects.effect import Effect
from experiments.effects.places import mask
from experiments.measurement.evidence import Evidence
from experiments.measurement.features import Change, Products, Variant, changes_of, gain, projected
from experiments.measurement.refit import Nominal, Placed, Refitted, refit, refit_effects

MOST_EFFECTS = 6
FINALISTS = 5  # effects that are refitted in each round
LEAST_GAIN = 40.0  # of chi^2 on held-out blocks: a chance of 1e-8 for one hypothesis, and there are a thousand
LEAST_SHARE = 0.01  # of the affected channels' noise variance: below this a model of a real robot is right
LEAST_STEP = 0.05  # of what is left over the noise: an effect that takes less is not what is missing
TIE = 0.25  # of what the winner leaves over the noise, or takes away: a rival that is closer cannot be told from it
NOISE = -0.05  # excess of chi^2 per residual under which nothing can be left to find
DOMINATED = 0.05  # of the best linear score: hypotheses below it are not refitted
SHORT_FIT = 4  # iterations of a finalist's refit


class Scored(NamedTuple):
    """A linear hypothesis with its score."""

    effect: Effect
    where: str
    gain: float  # fall of chi^2, linear, all blocks
    values: dict[str, float]


class Finalist(NamedTuple):
    """A refitted hypothesis; chi^2 on the blocks it was not fitted to."""

    scored: Scored
    fit: Refitted
    held_out: float


class Rung(NamedTuple):
    """A step of the error ladder: the fit to everything, and its proof, the fit to one half of the blocks."""

    name: str
    fit: Refitted
    proof: Refitted


@dataclass
class Selection:
    """What was selected, and all that was considered on the way."""

    fit: Refitted
    nominal: Sequence[Nominal]
    ladder: list[Rung] = field(default_factory=list)
    rankings: list[list[Scored]] = field(default_factory=list)
    ties: list[list[tuple[str, str]]] = field(default_factory=list)
    winners: list[Refitted] = field(default_factory=list)
    rivals: list[list[Refitted]] = field(default_factory=list)  # of each winner, fitted as well as it


def select(
    logs: Sequence[Evidence], nominal: Sequence[Nominal], say: Callable[[str], None], most: int = MOST_EFFECTS, least: float = NOISE
) -> Selection:
    """Add effects while held-out blocks say that each is there and chi^2 per residual exceeds 1 by more than `least`."""
    effects = logs[0].atoms.effects
    changes, variants = changes_of(effects)
    train, test = halves(logs)
    fit = refit(logs, (), nominal, iterations=3)
    proof = refit(logs, (), nominal, fit, train, iterations=1)
    selection = Selection(fit, nominal, ladder=[Rung("nominal model", fit, proof)])
    while len(selection.fit.effects) < most and _excess(logs, selection.fit) > least:
        say(f"scoring {len(variants)} hypotheses at every place")
        ranking = score(logs, selection.fit, nominal, changes, variants)
        selection.rankings.append(ranking)
        before = _on(refit_effects(logs, selection.fit.effects, nominal, selection.fit, train, 2), test)
        finalists = []
        for scored in _finalists(ranking, selection.fit.effects):
            say(f"refitting {scored.effect.name}@{scored.where}")
            trial = (*selection.fit.effects, Placed(scored.effect.name, scored.where, scored.values))
            fitted = refit_effects(logs, trial, nominal, selection.fit, train, SHORT_FIT)
            finalists.append(Finalist(scored, fitted, _on(fitted, test)))
        finalists.sort(key=lambda f: f.held_out)
        if not finalists or not _proven(finalists[0], before, logs, test):
            break
        winner, rivals = _simplest(finalists, before, _weight(logs, test))
        full = refit(logs, winner.fit.effects, nominal, winner.fit)
        selection.ties.append([(f.scored.effect.name, f.scored.where) for f in rivals])
        selection.winners.append(winner.fit)
        selection.rivals.append([f.fit for f in rivals])
        selection.fit = full
        selection.ladder.append(Rung(f"+ {winner.scored.effect.name}@{winner.scored.where}", full, winner.fit))
    return selection


def score(
    logs: Sequence[Evidence],
    fit: Refitted,
    nominal: Sequence[Nominal],
    changes: list[Change],
    variants: list[Variant],
) -> list[Scored]:
    """Every effect at its best place and shape, best first."""
    atoms = logs[0].atoms
    products = [log.products(point, changes) for log, point in zip(logs, fit.points, strict=True)]
    reduced = [_without_nuisances(p, atoms, nominal, changes) for p in products]
    found = []
    for variant in variants:
        for where in atoms.places(variant.effect):
            place = mask(where, variant.effect.axis, atoms.joint_names)
            directions = [p.direction(atoms, variant, changes, place) for p in products]
            scored = _joint_gain(reduced, directions)
            values = dict(changes[variant.changes[0]].shapes)
            values |= {changes[k].strength: float(v) for k, v in zip(variant.changes, scored.values, strict=True)}
            value_gain = scored.gain if _possible(variant.effect, values) else 0.0
            found.append(Scored(variant.effect, where, value_gain, _bounded(variant.effect, values)))
    return sorted(found, key=lambda s: -s.gain)


def best_of_each(ranking: Sequence[Scored]) -> list[Scored]:
    """The best place and shape of each effect."""
    seen, best = set(), []
    for scored in ranking:
        if scored.effect.name not in seen:
            seen.add(scored.effect.name)
            best.append(scored)
    return best


def _finalists(ranking: Sequence[Scored], chosen: Sequence[Placed]) -> list[Scored]:
    taken = {(p.effect, p.where) for p in chosen}
    fresh = [s for s in ranking if (s.effect.name, s.where) not in taken]
    best = [s for s in best_of_each(fresh) if s.gain > LEAST_GAIN / 2][:FINALISTS]
    best = [s for s in best if s.gain > DOMINATED * best[0].gain]
    if best:  # the winner's next best place is a hypothesis of its own
        rivals = [s for s in fresh if s.effect is best[0].effect and s.where != best[0].where]
        best += [s for s in rivals if s.gain > 0.7 * best[0].gain][:1]
    return best


def _simplest(finalists: list[Finalist], before: float, noise: float) -> tuple[Finalist, list[Finalist]]:
    """Of those that the held-out blocks cannot tell from the best, the one with the fewest parameters, and its rivals.

    A rival with more parameters is no rival: an effect that holds another as its limit always fits as well.
    """
    best = finalists[0].held_out
    reach = max(TIE * min(best - noise, before - best), LEAST_GAIN)
    enough = max(best + reach, noise)  # nothing is better than noise
    close = [f for f in finalists if f.held_out <= enough]
    fewest = min(len(f.scored.effect.parameters) for f in close)
    simple = [f for f in close if len(f.scored.effect.parameters) == fewest]
    return simple[0], simple[1:]


def _proven(winner: Finalist, before: float, logs: Sequence[Evidence], test) -> bool:
    share = winner.scored
    points = _weight(logs, test)
    axis = {"joint": 12, "link": 12, "foot": 4, "torso": 1}[share.effect.axis]
    affected = (
        points
        * mask(share.where, share.effect.axis, logs[0].atoms.joint_names).sum()
        / min(axis, len(mask(share.where, share.effect.axis, logs[0].atoms.joint_names)))
    )
    return before - winner.held_out > max(LEAST_GAIN, LEAST_SHARE * affected, LEAST_STEP * (before - points))


def _without_nuisances(p: Products, atoms, nominal, changes) -> np.ndarray:
    width = p.gram.shape[1]
    directions = [np.eye(width)[i] for i in p.nuisances]
    prior = [1.0] * len(directions)
    for n in nominal:
        k = next(k for k, c in enumerate(changes) if (c.effect.name, c.strength) == (n.effect, n.parameter))
        column = np.zeros(width)
        place = mask(n.where, changes[k].effect.axis, atoms.joint_names)
        column[p.start[k] : p.start[k] + len(place)] = place / changes[k].step * n.deviation
        directions.append(column)
        prior.append(1.0)
    return projected(p.gram.sum(0), directions, np.array(prior))


def _joint_gain(reduced: list[np.ndarray], directions: list[np.ndarray]):
    """One hypothesis over several logs: its parameters are shared."""
    if len(reduced) == 1:
        return gain(reduced[0], directions[0])
    count = directions[0].shape[1]
    total = np.zeros((count + 1, count + 1))
    for w, d in zip(reduced, directions, strict=True):
        both = np.concatenate([d, np.eye(len(w))[:, -1:]], 1)
        total += both.T @ w @ both
    return gain(total, np.eye(count + 1)[:, :count])


def _possible(effect: Effect, values: dict[str, float]) -> bool:
    """Whether the strengths point into their bounds at all (a negative backlash does not)."""
    return all(p.low < 0 or values[p.name] > 0 for p in effect.strengths) if len(effect.strengths) == 1 else True


def _bounded(effect: Effect, values: dict[str, float]) -> dict[str, float]:
    return {p.name: float(np.clip(values.get(p.name, p.start), p.low, p.high)) for p in effect.parameters}


def halves(logs: Sequence[Evidence]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Alternate pairs of blocks: fitted on one half, proven on the other."""
    train = [np.arange(log.blocks) // 2 % 2 == 0 if log.blocks > 3 else np.arange(log.blocks) % 2 == 0 for log in logs]
    return train, [~mask_ for mask_ in train]


def _excess(logs: Sequence[Evidence], fit: Refitted) -> float:
    return fit.total / sum(log.weight().sum() for log in logs) - 1.0


def _weight(logs: Sequence[Evidence], blocks: Sequence[np.ndarray]) -> float:
    """Expected chi^2 of noise alone."""
    return float(sum((log.weight() * b).sum() for log, b in zip(logs, blocks, strict=True)))


def _on(fit: Refitted, blocks: Sequence[np.ndarray]) -> float:
    return float(sum((c * b).sum() for c, b in zip(fit.chi2, blocks, strict=True)))
