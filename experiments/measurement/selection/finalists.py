"""Finalists: which hypotheses of a ranking are refitted in the simulator, and how."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from experiments.effects.places import mask
from experiments.measurement.evidence.features import Change, Products
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Masks, Nominal, Placed, Refitted
from experiments.measurement.fits.refit import SHORT_FIT, refit, refit_effects
from experiments.measurement.fits.side_by_side import side_by_side
from experiments.measurement.selection.belief import LEAST_GAIN, Finalist, chi2_on
from experiments.measurement.selection.linear_score import Scored, best_of_each, following

EVERYWHERE = "all"
FINALISTS = 5  # effects that are refitted in each round
# and as many more as score nearly as well: of sharp effects the linear score tells little
NEARLY, MOST_FINALISTS = 0.5, 8
DOMINATED = 0.05  # of the best linear score: hypotheses below it are not refitted
REFINED, LONG_FIT = 2, 12  # finalists that are fitted again with all nominal numbers, and its iterations at most
ELSEWHERE = 0.7  # of the best one's linear score, from which its effect at another place is refitted, too
NEAR = 2.0  # times the best one's chi^2 on held-out blocks that they may leave


class Round(NamedTuple):
    """What the hypotheses of one round are refitted to."""

    logs: Sequence[Evidence]
    nominal: Sequence[Nominal]
    changes: list[Change]
    products: list[Products]
    train: Masks
    test: Masks
    say: Callable[[str], None]

    def refitted(self, fit: Refitted, ranking: Sequence[Scored]) -> list[Finalist]:
        """The best few of a ranking, each refitted beside the effects of a fit; best first."""
        finalists = side_by_side(partial(self._refitted, fit), _finalists(ranking, fit.effects))
        finalists = _with_nominal(finalists, self.logs, self.nominal, self.train, self.test)
        if finalists and self._may_be_everywhere(finalists[0].scored, fit.effects):
            finalists = sorted([*finalists, self._everywhere(fit, finalists[0])], key=lambda f: f.held_out)
        return finalists

    def _may_be_everywhere(self, best: Scored, chosen: Sequence[Placed]) -> bool:
        """Whether the best acts at a kind of joint or a leg, and might at all joints."""
        names = self.logs[0].atoms.joint_names
        taken = any((p.effect, p.where) == (best.effect.name, EVERYWHERE) for p in chosen)
        return best.effect.axis == "joint" and 1 < mask(best.where, "joint", names).sum() < len(names) and not taken

    def _everywhere(self, fit: Refitted, best: Finalist) -> Finalist:
        """The best one's effect at all joints: of a sharp one, the linear score may favour some of those that have it.

        The nominal numbers start as they are given, not where they went to make up for it at the other joints.
        """
        scored = best.scored._replace(where=EVERYWHERE, values=best.fit.effects[-1].parameters)
        begun = self._beside(fit, scored, np.zeros_like(fit.nominal)).fit
        free = refit(self.logs, begun.effects, self.nominal, begun, self.train, SHORT_FIT)
        return Finalist(scored, free, chi2_on(free, self.test))

    def _refitted(self, fit: Refitted, scored: Scored) -> Finalist:
        """Nominal numbers follow the linear score; where that takes the fit farther off than it was, they stay."""
        nominal = following(self.logs, self.products, fit, self.nominal, self.changes, scored)
        followed = self._beside(fit, scored, nominal)
        if chi2_on(followed.fit, self.train) < chi2_on(fit, self.train):
            return followed
        return min(followed, self._beside(fit, scored, fit.nominal), key=lambda f: chi2_on(f.fit, self.train))

    def _beside(self, fit: Refitted, scored: Scored, nominal: np.ndarray) -> Finalist:
        """A hypothesis refitted beside the effects of a fit, with the nominal numbers held there."""
        self.say(f"refitting {scored.effect.name}@{scored.where}")
        trial = (*fit.effects, Placed(scored.effect.name, scored.where, scored.values))
        held = replace(fit, nominal=nominal)
        fitted = refit_effects(self.logs, trial, self.nominal, held, self.train, SHORT_FIT)
        return Finalist(scored, fitted, chi2_on(fitted, self.test))


def at_other_joints(ranking: Sequence[Scored], joint_names: tuple[str, ...]) -> list[Scored]:
    """The hypotheses at joints where the best one does not act."""
    best = ranking[0]
    if best.effect.axis != "joint":
        return []
    taken = mask(best.where, "joint", joint_names)
    return [s for s in ranking if s.effect.axis == "joint" and not (mask(s.where, "joint", joint_names) * taken).any()]


def _with_nominal(
    finalists: list[Finalist],
    logs: Sequence[Evidence],
    nominal: Sequence[Nominal],
    train: Masks,
    test: Masks,
) -> list[Finalist]:
    """Best first; the best few are fitted again with the nominal numbers free."""
    finalists.sort(key=lambda f: f.held_out)
    near = [f for f in finalists[:REFINED] if f.held_out < NEAR * finalists[0].held_out]

    def again(finalist: Finalist) -> Finalist:
        fit = refit(logs, finalist.fit.effects, nominal, finalist.fit, train, LONG_FIT)
        return finalist._replace(fit=fit, held_out=chi2_on(fit, test))

    return sorted([*side_by_side(again, near), *finalists[len(near) :]], key=lambda f: f.held_out)


def _finalists(ranking: Sequence[Scored], chosen: Sequence[Placed]) -> list[Scored]:
    taken = {(p.effect, p.where) for p in chosen}
    fresh = [s for s in ranking if (s.effect.name, s.where) not in taken]
    best = [s for s in best_of_each(fresh) if s.gain > LEAST_GAIN / 2][:MOST_FINALISTS]
    near = sum(s.gain > NEARLY * best[0].gain for s in best)
    best = [s for s in best[: max(FINALISTS, near)] if s.gain > DOMINATED * best[0].gain]
    if best:  # the winner's next best place is a hypothesis of its own
        rivals = [s for s in fresh if s.effect is best[0].effect and s.where != best[0].where]
        best += [s for s in rivals if s.gain > ELSEWHERE * best[0].gain][:1]
    return best
