"""Selection: score every hypothesis, refit the best in the simulator, keep what held-out blocks prove.

One effect at a time. The linear score of every effect at every place, with the robot's nominal numbers projected out,
proposes; the non-linear refit on half of the blocks and its error on the other half decide.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from experiments.effects.places import mask
from experiments.measurement.belief import (
    LEAST_GAIN,
    Finalist,
    all_blocks,
    chi2_on,
    halves,
    proven,
    simplest,
    told_from_none,
    weight_of,
)
from experiments.measurement.elsewhere import Elsewhere
from experiments.measurement.evidence import Evidence
from experiments.measurement.features import changes_of
from experiments.measurement.fit_types import Nominal, Placed, Refitted
from experiments.measurement.linear_score import Scored, best_of_each, following, scored_at
from experiments.measurement.misfit import above_floor, excess
from experiments.measurement.refit import refit, refit_effects

MOST_EFFECTS = 6
FINALISTS = 5  # effects that are refitted in each round
# and as many more as score nearly as well: of sharp effects the linear score tells little
NEARLY, MOST_FINALISTS = 0.5, 8
CLEAR_GAIN, CLEAR_SHARE = 300.0, 0.03  # linear score, and of the noise where it acts, that make an effect worth a try
LEAST_REST = 0.005  # of noise's own chi^2, above the floor: a smaller rest is no effect
NOISE = -0.05  # excess of chi^2 per residual under which nothing can be left to find
DOMINATED = 0.05  # of the best linear score: hypotheses below it are not refitted
SHORT_FIT = 4  # iterations of a finalist's refit
REFINED = 2  # finalists that are fitted again with all nominal numbers
NEAR = 2.0  # times the best one's chi^2 on held-out blocks that they may leave


class Rung(NamedTuple):
    """A step of the error ladder: the fit to everything, and its proof, the fit to one half of the blocks."""

    name: str
    fit: Refitted
    proof: Refitted


class Refuted(NamedTuple):
    """An effect that explains some of the logs and, learned there, makes another one worse."""

    effect: str
    where: str
    log: str


@dataclass
class Selection:
    """What was selected, and all that was considered on the way."""

    fit: Refitted
    nominal: Sequence[Nominal]
    elsewhere: Elsewhere
    ladder: list[Rung] = field(default_factory=list)
    rankings: list[list[Scored]] = field(default_factory=list)
    refitted: list[dict[tuple[str, str], float]] = field(default_factory=list)  # held-out chi^2 of each finalist
    refuted: list[Refuted] = field(default_factory=list)
    ties: list[list[tuple[str, str]]] = field(default_factory=list)
    winners: list[Refitted] = field(default_factory=list)
    rivals: list[list[Refitted]] = field(default_factory=list)  # of each winner, fitted as well as it


def select(
    logs: Sequence[Evidence],
    nominal: Sequence[Nominal],
    say: Callable[[str], None],
    most: int = MOST_EFFECTS,
    least: float = NOISE,
    promising: float = 0.0,
    begun: Rung | None = None,
    start: Refitted | None = None,
) -> Selection:
    """Add effects while held-out blocks say that each is there and chi^2 per residual exceeds 1 by over `least`.

    None is refitted unless the best linear score takes the share `promising` of what chi^2 has over the noise. `begun`
    is the ladder's first rung, where it is known from another selection with the same nominal numbers; `start` a fit
    without effects that is near it.
    """
    effects = logs[0].atoms.effects
    changes, variants = changes_of(effects, logs)
    train, test = halves(logs)
    if begun is None:
        fit = refit(logs, (), nominal, start)
        begun = Rung("nominal model", fit, refit(logs, (), nominal, fit, train, SHORT_FIT))
    selection = Selection(begun.fit, nominal, Elsewhere(logs, nominal), ladder=[begun])
    while len(selection.fit.effects) < most and excess(logs, selection.fit) > least:
        if selection.fit.effects and not _more(logs, selection):
            break
        say(f"scoring {len(variants)} hypotheses at every place")
        before = selection.ladder[-1].proof
        products = [log.products(point, changes) for log, point in zip(logs, selection.fit.points, strict=True)]
        ranking = scored_at(logs, products, selection.fit, nominal, changes, variants)
        selection.rankings.append(ranking)
        noise = weight_of(logs, all_blocks(logs))
        worth = _more(logs, selection) or stands_out(ranking, noise, logs[0].atoms.joint_names)
        if ranking[0].gain < promising * (selection.fit.total - noise) or not worth:
            break
        finalists = []
        for scored in _finalists(ranking, selection.fit.effects):
            say(f"refitting {scored.effect.name}@{scored.where}")
            trial = (*selection.fit.effects, Placed(scored.effect.name, scored.where, scored.values))
            held = replace(selection.fit, nominal=following(logs, products, selection.fit, nominal, changes, scored))
            fitted = refit_effects(logs, trial, nominal, held, train, SHORT_FIT)
            finalists.append(Finalist(scored, fitted, chi2_on(fitted, test)))
        finalists = _with_nominal(finalists, logs, nominal, train, test)
        selection.refitted.append({(f.scored.effect.name, f.scored.where): f.held_out for f in finalists})
        chosen = _chosen(finalists, before, logs, test, selection)
        if chosen is None:
            break
        winner, rivals = chosen
        full = refit(logs, winner.fit.effects, nominal, winner.fit)
        selection.ties.append([(f.scored.effect.name, f.scored.where) for f in rivals])
        selection.winners.append(winner.fit)
        selection.rivals.append([f.fit for f in rivals])
        selection.fit = full
        selection.ladder.append(Rung(f"+ {winner.scored.effect.name}@{winner.scored.where}", full, winner.fit))
        _pruned(selection, logs, train, test)
    return selection


def _more(logs: Sequence[Evidence], selection: Selection) -> bool:
    """Whether the fit leaves anything above the floor that is worth an effect."""
    return above_floor(logs, selection.fit) > max(LEAST_GAIN, LEAST_REST * weight_of(logs, all_blocks(logs)))


def stands_out(ranking: Sequence[Scored], noise: float, joint_names: tuple[str, ...]) -> bool:
    """Whether an effect at a few joints is worth a try though what is left is little beside the whole robot's `noise`.

    Of the four robots without an effect that this was set on, the best score was 244 and the largest share 1 %.
    """
    for best in best_of_each(ranking)[:FINALISTS]:
        place = mask(best.where, best.effect.axis, joint_names)
        if best.gain > max(CLEAR_GAIN, CLEAR_SHARE * noise * place.sum() / len(place)):
            return True
    return False


def _chosen(
    finalists: list[Finalist], before: Refitted, logs: Sequence[Evidence], test, selection: Selection
) -> tuple[Finalist, list[Finalist]] | None:
    """The winner and its rivals: proven on held-out blocks and, of several logs, not refuted by one left out whole."""
    finalists = [f for f in finalists if told_from_none(f.scored.effect, f.fit)]
    best = finalists[0] if finalists else None
    if best is None or not proven(best.scored.effect, best.scored.where, before, best.held_out, logs, test):
        return None
    winner, rivals = simplest(finalists, chi2_on(before, test), weight_of(logs, test), logs[0].atoms.joint_names)
    close = [winner, *rivals]
    for one in close:
        log = selection.elsewhere.refutes(one.fit.effects, one.fit)
        if log is None:
            return one, [other for other in close if other is not one]
        selection.refuted.append(Refuted(one.scored.effect.name, one.scored.where, log))
    return None


def _with_nominal(finalists: list[Finalist], logs, nominal, train, test) -> list[Finalist]:
    """Best first; the best few are fitted again with the nominal numbers free."""
    finalists.sort(key=lambda f: f.held_out)
    near = [f for f in finalists[:REFINED] if f.held_out < NEAR * finalists[0].held_out]
    for i, finalist in enumerate(near):
        fit = refit(logs, finalist.fit.effects, nominal, finalist.fit, train, SHORT_FIT)
        finalists[i] = finalist._replace(fit=fit, held_out=chi2_on(fit, test))
    return sorted(finalists, key=lambda f: f.held_out)


def _finalists(ranking: Sequence[Scored], chosen: Sequence[Placed]) -> list[Scored]:
    taken = {(p.effect, p.where) for p in chosen}
    fresh = [s for s in ranking if (s.effect.name, s.where) not in taken]
    best = [s for s in best_of_each(fresh) if s.gain > LEAST_GAIN / 2][:MOST_FINALISTS]
    near = sum(s.gain > NEARLY * best[0].gain for s in best)
    best = [s for s in best[: max(FINALISTS, near)] if s.gain > DOMINATED * best[0].gain]
    if best:  # the winner's next best place is a hypothesis of its own
        rivals = [s for s in fresh if s.effect is best[0].effect and s.where != best[0].where]
        best += [s for s in rivals if s.gain > 0.7 * best[0].gain][:1]
    return best


def _pruned(selection: Selection, logs: Sequence[Evidence], train, test) -> None:
    """Take out, the last one apart, each effect that the later ones have made needless."""
    known = {effect.name: effect for effect in logs[0].atoms.effects}
    for k in reversed(range(len(selection.fit.effects) - 1)):
        placed, others = selection.fit.effects[k], list(selection.fit.effects)
        del others[k]
        without = refit(logs, others, selection.nominal, selection.fit, train, SHORT_FIT)
        after = chi2_on(selection.ladder[-1].proof, test)
        if proven(known[placed.effect], placed.where, without, after, logs, test):
            continue
        for one in (selection.ties, selection.winners, selection.rivals):
            del one[k]
        rungs = selection.ladder[: k + 1]
        for i in range(k + 1, len(others) + 1):
            full = refit(logs, others[:i], selection.nominal, rungs[-1].fit)
            proof = refit(logs, full.effects, selection.nominal, full, train, SHORT_FIT)
            rungs.append(Rung(f"+ {others[i - 1].effect}@{others[i - 1].where}", full, proof))
        selection.ladder, selection.fit = rungs, rungs[-1].fit
