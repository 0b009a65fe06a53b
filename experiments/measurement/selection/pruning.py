"""What selection takes back: effects that are needless, that no fit tells from none, or that are not steady."""

from collections.abc import Callable, Sequence
from functools import partial

from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Masks, Placed, Refitted
from experiments.measurement.fits.refit import SHORT_FIT, refit
from experiments.measurement.fits.side_by_side import side_by_side
from experiments.measurement.selection.belief import all_blocks, chi2_on, halves, proven, told_from_none
from experiments.measurement.selection.ladder import Rung, Selection
from experiments.measurement.selection.steadiness import changes_in


def take_out_needless(selection: Selection, logs: Sequence[Evidence], train: Masks, test: Masks) -> None:
    """Take out, the last one apart, each effect that the later ones have made needless."""
    known = {effect.name: effect for effect in logs[0].atoms.effects}
    without: list[Refitted] = []
    for k in reversed(range(len(selection.fit.effects) - 1)):
        if not without:
            without = side_by_side(partial(_without, selection, logs, train), range(k + 1))
        placed, after = selection.fit.effects[k], chi2_on(selection.ladder[-1].proof, test)
        if not proven(known[placed.effect], placed.where, without[k], after, logs, test):
            _taken_out(selection, k, logs, train)
            without = []  # they were fits beside it


def take_out_idle(selection: Selection, logs: Sequence[Evidence], train: Masks) -> None:
    """Take out each effect that the fit to everything neither tells from none nor needs."""
    known = {effect.name: effect for effect in logs[0].atoms.effects}
    for k in reversed(range(len(selection.fit.effects))):
        placed = selection.fit.effects[k]
        if told_from_none(known[placed.effect], selection.fit, k):
            continue
        without = refit(logs, _others(selection.fit.effects, k), selection.nominal, selection.fit)
        if not proven(known[placed.effect], placed.where, without, selection.fit.total, logs, all_blocks(logs)):
            _taken_out(selection, k, logs, train)


def _taken_out(selection: Selection, k: int, logs: Sequence[Evidence], train: Masks) -> None:
    """The selection without its k-th effect; the later ones are fitted again."""
    others = _others(selection.fit.effects, k)
    selection.forget(k)
    rungs = selection.ladder[: k + 1]
    for i in range(k + 1, len(others) + 1):
        full = refit(logs, others[:i], selection.nominal, rungs[-1].fit)
        proof = refit(logs, full.effects, selection.nominal, full, train, SHORT_FIT)
        rungs.append(Rung(f"+ {others[i - 1].effect}@{others[i - 1].where}", full, proof))
    selection.ladder, selection.fit = rungs, rungs[-1].fit


def _without(selection: Selection, logs: Sequence[Evidence], train: Masks, k: int) -> Refitted:
    """A fit to the blocks `train` without the k-th effect."""
    return refit(logs, _others(selection.fit.effects, k), selection.nominal, selection.fit, train, SHORT_FIT)


def _others(effects: Sequence[Placed], k: int) -> list[Placed]:
    return [*effects[:k], *effects[k + 1 :]]


def take_out_unsure(selection: Selection) -> None:
    """Take back, with all after it, an effect that no later one has helped to tell from none."""
    effects = {effect.name: effect for effect in selection.elsewhere.logs[0].atoms.effects}
    for k, (placed, sure) in enumerate(zip(selection.fit.effects, selection.sure, strict=True)):
        if not sure and not told_from_none(effects[placed.effect], selection.fit, k):
            selection.forget(slice(k, None))
            del selection.ladder[k + 1 :]
            selection.fit = selection.ladder[-1].fit
            return


def take_out_unsteady(selection: Selection, logs: Sequence[Evidence], say: Callable[[str], None]) -> None:
    """Take out effects whose law would have to change along the log: what they explain has another one."""
    train, _ = halves(logs)
    while changes := changes_in(logs, selection.fit, selection.nominal):
        clearest = changes[0]
        say(clearest.in_words())
        k = [placed[:2] for placed in selection.fit.effects].index((clearest.effect, clearest.where))
        selection.unsteady.append(clearest)
        _taken_out(selection, k, logs, train)
