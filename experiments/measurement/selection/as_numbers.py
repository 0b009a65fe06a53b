"""A selection made over: those of its effects that may be no more than nominal numbers which are off, as such numbers.

A sharp effect may only be found from numbers as they are given, and then numbers that are off are called effects
beside it; from numbers that went where they make up for a missing sharp effect, no fit finds the way back to it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fits.nominal import numbers_among
from experiments.measurement.fits.refit import SHORT_FIT, refit
from experiments.measurement.selection.belief import halves
from experiments.measurement.selection.elsewhere import Elsewhere
from experiments.measurement.selection.ladder import Rung, Selection
from experiments.measurement.selection.pruning import take_out_idle, take_out_needless


def as_numbers(
    logs: Sequence[Evidence], found: Selection, nominal: Sequence[Nominal], alone: Refitted
) -> Selection | None:
    """What was found with the nominal numbers as given, refitted with them free; `alone`: the fit of those only.

    None where no effect may be such a number, or none of the others is sharp.
    """
    off = numbers_among(found.fit.effects, nominal)
    kept = [k for k, placed in enumerate(found.fit.effects) if placed not in off]
    sharp = {effect.name for effect in logs[0].atoms.effects if effect.sharp}
    if not off or not any(found.fit.effects[k].effect in sharp for k in kept):
        return None
    train, test = halves(logs)
    begun = Rung(found.ladder[0].name, alone, refit(logs, (), nominal, alone, train, SHORT_FIT))
    asked = {"rankings": found.rankings, "refitted": found.refitted, "refuted": found.refuted}
    selection = Selection(alone, nominal, Elsewhere(logs, nominal), ladder=[begun], **asked)
    start, effects = _begun(found, off, nominal), ()
    for k in kept:
        effects = (*effects, found.fit.effects[k])
        # each from the numbers as they were: where they go without the later ones, they make up for those
        fit = refit(logs, effects, nominal, start)
        proof = refit(logs, fit.effects, nominal, fit, train, SHORT_FIT)
        selection.take_over(found, k, Rung(found.ladder[k + 1].name, fit, proof))
    take_out_needless(selection, logs, train, test)
    take_out_idle(selection, logs, train)
    return selection


def _begun(found: Selection, off: Sequence[Placed], nominal: Sequence[Nominal]) -> Refitted:
    """A start without effects: the numbers where the selection has them, or the effects that stand for them."""
    values = {(n.effect, n.where, n.parameter): x for n, x in zip(found.nominal, found.fit.nominal, strict=True)}
    values |= {(p.effect, p.where, name): x for p in off for name, x in p.parameters.items()}
    start = np.array([values.get((n.effect, n.where, n.parameter), 0.0) for n in nominal])
    return replace(found.fit, effects=(), nominal=start, spread=np.zeros(len(start)))
