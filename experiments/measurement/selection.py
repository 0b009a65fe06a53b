"""Selection: score every hypothesis, refit the best in the simulator, keep what held-out blocks prove.

One effect at a time. The linear score of every effect at every place, with the robot's nominal numbers projected out,
proposes; the non-linear refit on half of the blocks and its error on the other half decide.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from experiments.measurement.belief import (
    CLEAR_GAIN,
    LEAST_GAIN,
    all_blocks,
    chi2_on,
    halves,
    proven,
    told_from_none,
    weight_of,
)
from experiments.measurement.choice import Judge, Refuted
from experiments.measurement.elsewhere import Elsewhere
from experiments.measurement.evidence import Evidence
from experiments.measurement.features import changes_of
from experiments.measurement.finalists import FINALISTS, SHORT_FIT, Round, at_other_joints
from experiments.measurement.fit_types import Nominal, Placed, Refitted
from experiments.measurement.footprint import noise_at
from experiments.measurement.linear_score import Scored, best_of_each, scored_at
from experiments.measurement.misfit import above_floor, excess
from experiments.measurement.refit import refit

MOST_EFFECTS = 6
CLEAR_SHARE = 0.03  # of the noise where it acts, that a score has to be for an effect to be worth a try
ALONE = 4.0  # times the next effect's linear score, from which the best one is worth a refit whatever it explains
NEGLIGIBLE = 5e-6  # of the nominal model's misfit: what a strong effect's own equation may be wrong by
LEAST_REST = 0.005  # of noise's own chi^2, above the floor: a smaller rest is no effect
NOISE = -0.05  # excess of chi^2 per residual under which nothing can be left to find


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
    elsewhere: Elsewhere
    ladder: list[Rung] = field(default_factory=list)
    rankings: list[list[Scored]] = field(default_factory=list)
    refitted: list[dict[tuple[str, str], float]] = field(default_factory=list)  # held-out chi^2 of each finalist
    refuted: list[Refuted] = field(default_factory=list)
    ties: list[list[tuple[str, str]]] = field(default_factory=list)
    winners: list[Refitted] = field(default_factory=list)
    rivals: list[list[Refitted]] = field(default_factory=list)  # of each winner, fitted as well as it
    sure: list[bool] = field(default_factory=list)  # of each winner, when it was chosen


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

    None is refitted unless the best linear score takes the share `promising` of what chi^2 has over the noise, or is
    far above all others' (of a sharp effect it tells little). `begun` is the ladder's first rung, where it is known
    from another selection with the same nominal numbers; `start` a fit without effects that is near it.
    """
    train, test = halves(logs)
    if begun is None:
        fit = refit(logs, (), nominal, start)
        begun = Rung("nominal model", fit, refit(logs, (), nominal, fit, train, SHORT_FIT))
    selection = Selection(begun.fit, nominal, Elsewhere(logs, nominal), ladder=[begun])
    while len(selection.fit.effects) < most and excess(logs, selection.fit) > least:
        more = leaves_more(logs, selection)
        if selection.fit.effects and not more:
            break
        changes, variants = changes_of(logs[0].atoms.effects, logs, selection.fit.points)
        say(f"scoring {len(variants)} hypotheses at every place")
        before = selection.ladder[-1].proof
        products = [log.products(point, changes) for log, point in zip(logs, selection.fit.points, strict=True)]
        ranking = scored_at(logs, products, selection.fit, nominal, changes, variants)
        selection.rankings.append(ranking)
        noise = weight_of(logs, all_blocks(logs))
        worth = more or stands_out(ranking, logs)
        if not worth or not _promises(ranking, promising * (selection.fit.total - noise)):
            break
        round_ = Round(logs, nominal, changes, products, train, test, say)
        finalists = round_.refitted(selection.fit, ranking)
        selection.refitted.append({(f.scored.effect.name, f.scored.where): f.held_out for f in finalists})
        judge = Judge(logs, before, test, selection.elsewhere, selection.refuted)
        chosen = judge.choice(finalists)
        if chosen is None:  # what nothing explains at some joints must not hide an effect at others
            others = at_other_joints(ranking, logs[0].atoms.joint_names)
            if not stands_out(others, logs):
                break
            chosen = judge.choice(round_.refitted(selection.fit, others))
            if chosen is None:
                break
        winner, rivals, sure = chosen
        full = refit(logs, winner.fit.effects, nominal, winner.fit)
        selection.ties.append([(f.scored.effect.name, f.scored.where) for f in rivals])
        selection.winners.append(winner.fit)
        selection.rivals.append([f.fit for f in rivals])
        selection.sure.append(sure)
        selection.fit = full
        selection.ladder.append(Rung(f"+ {winner.scored.effect.name}@{winner.scored.where}", full, winner.fit))
        _pruned(selection, logs, train, test)
    _without_unsure(selection)
    _without_idle(selection, logs, train)
    return selection


def leaves_more(logs: Sequence[Evidence], selection: Selection) -> bool:
    """Whether what was found leaves anything above the floor that is worth an effect."""
    tiny = NEGLIGIBLE * above_floor(logs, selection.ladder[0].fit)
    return above_floor(logs, selection.fit) > max(LEAST_GAIN, LEAST_REST * weight_of(logs, all_blocks(logs)), tiny)


def _promises(ranking: Sequence[Scored], least: float) -> bool:
    """Whether the best linear score reaches `least` or is ALONE times that of any other effect."""
    best, *others = best_of_each(ranking)
    return best.gain >= min(least, ALONE * max((s.gain for s in others), default=0.0))


def stands_out(ranking: Sequence[Scored], logs: Sequence[Evidence]) -> bool:
    """Whether an effect is worth a try for what it explains where it acts, though that is little for the whole robot.

    Of the four robots without an effect that this was set on, the best score was 244 and the largest share 1 %.
    """
    for best in best_of_each(ranking)[:FINALISTS]:
        if best.gain > max(CLEAR_GAIN, CLEAR_SHARE * noise_at(best.effect, best.where, logs, all_blocks(logs))):
            return True
    return False


def _pruned(selection: Selection, logs: Sequence[Evidence], train, test) -> None:
    """Take out, the last one apart, each effect that the later ones have made needless."""
    known = {effect.name: effect for effect in logs[0].atoms.effects}
    for k in reversed(range(len(selection.fit.effects) - 1)):
        placed, others = selection.fit.effects[k], _others(selection.fit.effects, k)
        without = refit(logs, others, selection.nominal, selection.fit, train, SHORT_FIT)
        after = chi2_on(selection.ladder[-1].proof, test)
        if not proven(known[placed.effect], placed.where, without, after, logs, test):
            _taken_out(selection, k, logs, train)


def _without_idle(selection: Selection, logs: Sequence[Evidence], train) -> None:
    """Take out each effect that the fit to everything neither tells from none nor needs."""
    known = {effect.name: effect for effect in logs[0].atoms.effects}
    for k in reversed(range(len(selection.fit.effects))):
        placed = selection.fit.effects[k]
        if told_from_none(known[placed.effect], selection.fit, k):
            continue
        without = refit(logs, _others(selection.fit.effects, k), selection.nominal, selection.fit)
        if not proven(known[placed.effect], placed.where, without, selection.fit.total, logs, all_blocks(logs)):
            _taken_out(selection, k, logs, train)


def _taken_out(selection: Selection, k: int, logs: Sequence[Evidence], train) -> None:
    """The selection without its k-th effect; the later ones are fitted again."""
    others = _others(selection.fit.effects, k)
    for one in (selection.ties, selection.winners, selection.rivals, selection.sure):
        del one[k]
    rungs = selection.ladder[: k + 1]
    for i in range(k + 1, len(others) + 1):
        full = refit(logs, others[:i], selection.nominal, rungs[-1].fit)
        proof = refit(logs, full.effects, selection.nominal, full, train, SHORT_FIT)
        rungs.append(Rung(f"+ {others[i - 1].effect}@{others[i - 1].where}", full, proof))
    selection.ladder, selection.fit = rungs, rungs[-1].fit


def _others(effects: Sequence[Placed], k: int) -> list[Placed]:
    return [*effects[:k], *effects[k + 1 :]]


def _without_unsure(selection: Selection) -> None:
    """Take back, with all after it, an effect that no later one has helped to tell from none."""
    effects = {effect.name: effect for effect in selection.elsewhere.logs[0].atoms.effects}
    for k, (placed, sure) in enumerate(zip(selection.fit.effects, selection.sure, strict=True)):
        if not sure and not told_from_none(effects[placed.effect], selection.fit, k):
            for one in (selection.ties, selection.winners, selection.rivals, selection.sure):
                del one[k:]
            del selection.ladder[k + 1 :]
            selection.fit = selection.ladder[-1].fit
            return
