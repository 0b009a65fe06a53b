"""Selection: score every hypothesis, refit the best in the simulator, keep what held-out blocks prove.

One effect at a time. The linear score of every effect at every place, with the robot's nominal numbers projected out,
proposes; the non-linear refit on half of the blocks and its error on the other half decide.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from experiments.effects.effect import Effect
from experiments.effects.places import mask
from experiments.measurement.evidence import Evidence
from experiments.measurement.features import Change, Products, Variant, changes_of, gain, projected
from experiments.measurement.refit import FARTHEST, Nominal, Placed, Refitted, refit, refit_effects

MOST_EFFECTS = 6
FINALISTS = 5  # effects that are refitted in each round
LEAST_GAIN = 40.0  # of chi^2 on held-out blocks: a chance of 1e-8 for one hypothesis, and there are a thousand
LEAST_SHARE = 0.01  # of the affected channels' noise variance: below this a model of a real robot is right
LEAST_STEP = 0.2  # of what is left over the noise: an effect that takes less is not what is missing
TIE = 0.25  # of what the winner leaves over the noise, or takes away: a rival that is closer cannot be told from it
NOISE = -0.05  # excess of chi^2 per residual under which nothing can be left to find
DOMINATED = 0.05  # of the best linear score: hypotheses below it are not refitted
SHORT_FIT = 4  # iterations of a finalist's refit
REFINED, NEAR = (
    2,
    2.0,
)  # finalists that are fitted again with all nominal numbers, and how near to the best they must be


class Scored(NamedTuple):
    """A linear hypothesis with its score."""

    effect: Effect
    where: str
    gain: float  # fall of chi^2, linear, all blocks
    values: dict[str, float]
    variant: Variant


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
    logs: Sequence[Evidence],
    nominal: Sequence[Nominal],
    say: Callable[[str], None],
    most: int = MOST_EFFECTS,
    least: float = NOISE,
) -> Selection:
    """Add effects while held-out blocks say that each is there and chi^2 per residual exceeds 1 by over `least`."""
    effects = logs[0].atoms.effects
    changes, variants = changes_of(effects, logs)
    train, test = halves(logs)
    fit = refit(logs, (), nominal)
    proof = refit(logs, (), nominal, fit, train, SHORT_FIT)
    selection = Selection(fit, nominal, ladder=[Rung("nominal model", fit, proof)])
    while len(selection.fit.effects) < most and _excess(logs, selection.fit) > least:
        say(f"scoring {len(variants)} hypotheses at every place")
        proof = selection.ladder[-1].proof
        before = _on(proof, test)
        products = [log.products(point, changes) for log, point in zip(logs, selection.fit.points, strict=True)]
        ranking = _scored(logs, products, nominal, changes, variants)
        selection.rankings.append(ranking)
        finalists = []
        for scored in _finalists(ranking, selection.fit.effects):
            say(f"refitting {scored.effect.name}@{scored.where}")
            trial = (*selection.fit.effects, Placed(scored.effect.name, scored.where, scored.values))
            held = replace(selection.fit, nominal=_following(logs, products, selection.fit, nominal, changes, scored))
            fitted = refit_effects(logs, trial, nominal, held, train, SHORT_FIT)
            finalists.append(Finalist(scored, fitted, _on(fitted, test)))
        finalists = _with_nominal(finalists, logs, nominal, train, test)
        best = finalists[0] if finalists else None
        if best is None or not _proven(best.scored.effect, best.scored.where, before, best.held_out, logs, test):
            break
        winner, rivals = _simplest(finalists, before, _weight(logs, test))
        full = refit(logs, winner.fit.effects, nominal, winner.fit)
        selection.ties.append([(f.scored.effect.name, f.scored.where) for f in rivals])
        selection.winners.append(winner.fit)
        selection.rivals.append([f.fit for f in rivals])
        selection.fit = full
        selection.ladder.append(Rung(f"+ {winner.scored.effect.name}@{winner.scored.where}", full, winner.fit))
        _pruned(selection, logs, train, test)
    return selection


def _with_nominal(finalists: list[Finalist], logs, nominal, train, test) -> list[Finalist]:
    """Best first; the best few are fitted again with the nominal numbers free."""
    finalists.sort(key=lambda f: f.held_out)
    near = [f for f in finalists[:REFINED] if f.held_out < NEAR * finalists[0].held_out]
    for i, finalist in enumerate(near):
        fit = refit(logs, finalist.fit.effects, nominal, finalist.fit, train, SHORT_FIT)
        finalists[i] = finalist._replace(fit=fit, held_out=_on(fit, test))
    return sorted(finalists, key=lambda f: f.held_out)


def score(
    logs: Sequence[Evidence],
    fit: Refitted,
    nominal: Sequence[Nominal],
    changes: list[Change],
    variants: list[Variant],
) -> list[Scored]:
    """Every effect at its best place and shape, best first."""
    products = [log.products(point, changes) for log, point in zip(logs, fit.points, strict=True)]
    return _scored(logs, products, nominal, changes, variants)


def _scored(logs, products: Sequence[Products], nominal, changes, variants) -> list[Scored]:
    atoms = logs[0].atoms
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
            found.append(Scored(variant.effect, where, value_gain, _bounded(variant.effect, values), variant))
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


def _proven(effect: Effect, where: str, before: float, after: float, logs: Sequence[Evidence], test) -> bool:
    """Whether the fall of chi^2 on held-out blocks says that the effect is there."""
    points, place = _weight(logs, test), mask(where, effect.axis, logs[0].atoms.joint_names)
    affected = points * place.sum() / len(place)
    return before - after > max(LEAST_GAIN, LEAST_SHARE * affected, LEAST_STEP * (before - points))


def _pruned(selection: Selection, logs: Sequence[Evidence], train, test) -> None:
    """Take out, the last one apart, each effect that the later ones have made needless."""
    known = {effect.name: effect for effect in logs[0].atoms.effects}
    for k in reversed(range(len(selection.fit.effects) - 1)):
        placed, others = selection.fit.effects[k], list(selection.fit.effects)
        del others[k]
        without = refit(logs, others, selection.nominal, selection.fit, train, SHORT_FIT)
        after = _on(selection.ladder[-1].proof, test)
        if _proven(known[placed.effect], placed.where, _on(without, test), after, logs, test):
            continue
        for one in (selection.ties, selection.winners, selection.rivals):
            del one[k]
        rungs = selection.ladder[: k + 1]
        for i in range(k + 1, len(others) + 1):
            full = refit(logs, others[:i], selection.nominal, rungs[-1].fit)
            proof = refit(logs, full.effects, selection.nominal, full, train, SHORT_FIT)
            rungs.append(Rung(f"+ {others[i - 1].effect}@{others[i - 1].where}", full, proof))
        selection.ladder, selection.fit = rungs, rungs[-1].fit


def _without_nuisances(p: Products, atoms, nominal, changes) -> np.ndarray:
    directions = [*_own(p), *_nominal_directions(p, atoms, nominal, changes)]
    return projected(p.gram.sum(0), directions, np.ones(len(directions)))


def _own(p: Products) -> list[np.ndarray]:
    """Directions of a log's own nuisances."""
    unit = np.eye(p.gram.shape[1])
    return [unit[i] for i in p.nuisances]


def _nominal_directions(p: Products, atoms, nominal, changes) -> list[np.ndarray]:
    """What each nominal number does when it is one deviation off."""
    directions = []
    for n in nominal:
        k = next(k for k, c in enumerate(changes) if (c.effect.name, c.strength) == (n.effect, n.parameter))
        column = np.zeros(p.gram.shape[1])
        place = mask(n.where, changes[k].effect.axis, atoms.joint_names)
        column[p.start[k] : p.start[k] + len(place)] = place / changes[k].step * n.deviation
        directions.append(column)
    return directions


def _following(logs, products: Sequence[Products], fit: Refitted, nominal, changes, scored: Scored) -> np.ndarray:
    """Where the nominal numbers want to be once a hypothesis has the value of its score (linear)."""
    if not nominal:
        return fit.nominal
    atoms, deviation = logs[0].atoms, np.array([n.deviation for n in nominal])
    now = fit.nominal / deviation
    hessian, gradient = np.eye(len(nominal)), now.copy()
    place = mask(scored.where, scored.effect.axis, atoms.joint_names)
    strengths = np.array([scored.values[changes[k].strength] for k in scored.variant.changes])
    for p in products:
        gram = projected(p.gram.sum(0), _own(p), np.ones(len(p.nuisances)))
        g = np.stack(_nominal_directions(p, atoms, nominal, changes), 1)
        moved = p.direction(atoms, scored.variant, changes, place) @ strengths
        moved[-1] += 1.0  # the residual itself
        hessian = hessian + g.T @ gram @ g
        gradient = gradient + g.T @ gram @ moved
    return np.clip(now - np.linalg.solve(hessian, gradient), -FARTHEST, FARTHEST) * deviation


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
