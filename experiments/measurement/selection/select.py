"""Selection: score every hypothesis, refit the best in the simulator, keep what held-out blocks prove.

One effect at a time. The linear score of every effect at every place, with the robot's nominal numbers projected out,
proposes; the non-linear refit on half of the blocks and its error on the other half decide.
"""

from collections.abc import Callable, Sequence

from experiments.measurement.evidence.features import changes_of
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fits.footprint import noise_at
from experiments.measurement.fits.misfit import above_floor, excess
from experiments.measurement.fits.refit import SHORT_FIT, refit
from experiments.measurement.selection.belief import CLEAR_GAIN, LEAST_GAIN, all_blocks, halves, weight_of
from experiments.measurement.selection.choice import Choice, Judge
from experiments.measurement.selection.elsewhere import Elsewhere
from experiments.measurement.selection.finalists import FINALISTS, Round, at_other_joints
from experiments.measurement.selection.ladder import Rung, Selection
from experiments.measurement.selection.linear_score import Scored, best_of_each, scored_at
from experiments.measurement.selection.lone import lone
from experiments.measurement.selection.pruning import take_out_idle, take_out_needless, take_out_unsure

MOST_EFFECTS = 6
CLEAR_SHARE = 0.03  # of the noise where it acts, that a score has to be for an effect to be worth a try
FAR_ABOVE = 4.0  # times the next effect's linear score, from which the best one is worth a refit whatever it explains
NEGLIGIBLE = 5e-6  # of the nominal model's misfit: what a strong effect's own equation may be wrong by
LEAST_REST = 0.005  # of noise's own chi^2, above the floor: a smaller rest is no effect
NOISE = -0.05  # excess of chi^2 per residual under which nothing can be left to find


def select(
    logs: Sequence[Evidence],
    nominal: Sequence[Nominal],
    say: Callable[[str], None],
    most: int = MOST_EFFECTS,
    least: float = NOISE,
    promising: float = 0.0,
    begun: Rung | None = None,
    start: Refitted | None = None,
    begin: Sequence[Placed] = (),
) -> Selection:
    """Add effects while held-out blocks say that each is there and chi^2 per residual exceeds 1 by over `least`; where
    it does not, the first only if it stands alone.

    None is refitted unless the best linear score takes the share `promising` of what chi^2 has over the noise, or is
    far above all others' (of a sharp effect it tells little). `begun` is the ladder's first rung, where it is known
    from another selection with the same nominal numbers; `start` a fit without effects that is near it; `begin` effects
    as another fit has them, from where theirs begin.
    """
    train, test = halves(logs)
    if begun is None:
        fit = refit(logs, (), nominal, start)
        begun = Rung("nominal model", fit, refit(logs, (), nominal, fit, train, SHORT_FIT))
    selection = Selection(begun.fit, nominal, Elsewhere(logs, nominal), [begun], begin=begin)
    while len(selection.fit.effects) < most:
        chosen = _next(logs, selection, least, promising, say)
        if chosen is None:
            break
        _add(selection, chosen, refit(logs, chosen.winner.fit.effects, nominal, chosen.winner.fit))
        take_out_needless(selection, logs, train, test)
    take_out_unsure(selection)
    take_out_idle(selection, logs, train)
    return selection


def _next(
    logs: Sequence[Evidence], selection: Selection, least: float, promising: float, say: Callable[[str], None]
) -> Choice | None:
    """One round: the effect that is proven beside those found, and its rivals; None where there is none."""
    quiet = excess(logs, selection.fit) <= least
    more = leaves_more(logs, selection) and not quiet
    if selection.fit.effects and not more:
        return None
    ranking, round_ = _scored(logs, selection, say)
    over = selection.fit.total - weight_of(logs, all_blocks(logs))
    if not more and (quiet or not stands_out(ranking, logs)):
        ranking = lone(logs, selection.fit, ranking, round_)
    if not ranking or not _promises(ranking, promising * over):
        return None
    finalists = round_.refitted(selection.fit, ranking)
    selection.refitted.append(finalists)
    judge = Judge(logs, selection.ladder[-1].proof, round_.test, selection.elsewhere, selection.refuted)
    chosen = judge.choice(finalists)
    if chosen is not None:
        return chosen
    # what nothing explains at some joints must not hide an effect at others
    others = at_other_joints(ranking, logs[0].atoms.joint_names)
    return judge.choice(round_.refitted(selection.fit, others)) if stands_out(others, logs) else None


def _scored(logs: Sequence[Evidence], selection: Selection, say: Callable[[str], None]) -> tuple[list[Scored], Round]:
    """The linear score of every hypothesis beside those found, and what their refits need."""
    changes, variants = changes_of(logs[0].atoms.effects, logs, selection.fit.points)
    say(f"scoring {len(variants)} hypotheses at every place")
    products = [log.products(point, changes) for log, point in zip(logs, selection.fit.points, strict=True)]
    ranking = scored_at(logs, products, selection.fit, selection.nominal, changes, variants)
    selection.rankings.append(ranking)
    known = {(placed.effect, placed.where): placed.parameters for placed in selection.begin}
    ranking = [s._replace(values={**s.values, **known.get((s.effect.name, s.where), {})}) for s in ranking]
    return ranking, Round(logs, selection.nominal, changes, products, *halves(logs), say)


def _add(selection: Selection, chosen: Choice, full: Refitted) -> None:
    """The next rung: a winner and its fit to everything."""
    winner, rivals, sure = chosen
    selection.ties.append([(f.scored.effect.name, f.scored.where) for f in rivals])
    selection.winners.append(winner.fit)
    selection.rivals.append([f.fit for f in rivals])
    selection.sure.append(sure)
    selection.fit = full
    selection.ladder.append(Rung(f"+ {winner.scored.effect.name}@{winner.scored.where}", full, winner.fit))


def leaves_more(logs: Sequence[Evidence], selection: Selection) -> bool:
    """Whether what was found leaves anything above the floor that is worth an effect."""
    tiny = NEGLIGIBLE * above_floor(logs, selection.ladder[0].fit)
    return above_floor(logs, selection.fit) > max(LEAST_GAIN, LEAST_REST * weight_of(logs, all_blocks(logs)), tiny)


def _promises(ranking: Sequence[Scored], least: float) -> bool:
    """Whether the best linear score reaches `least` or is FAR_ABOVE times that of any other effect."""
    best, *others = best_of_each(ranking)
    return best.gain >= min(least, FAR_ABOVE * max((s.gain for s in others), default=0.0))


def stands_out(ranking: Sequence[Scored], logs: Sequence[Evidence]) -> bool:
    """Whether an effect is worth a try for what it explains where it acts, though that is little for the whole robot.

    Of the four robots without an effect that this was set on, the best score was 244 and the largest share 1 %.
    """
    for best in best_of_each(ranking)[:FINALISTS]:
        if best.gain > max(CLEAR_GAIN, CLEAR_SHARE * noise_at(best.effect, best.where, logs, all_blocks(logs))):
            return True
    return False
