"""Which of a round's finalists is chosen: the simplest of those that held-out blocks, and other logs, prove."""

from collections.abc import Sequence
from typing import NamedTuple

from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Masks, Refitted
from experiments.measurement.fits.footprint import left_at
from experiments.measurement.selection.belief import (
    CLEAR_GAIN,
    MOST,
    Finalist,
    at_end_of_shape,
    chi2_on,
    loud,
    plain,
    proven,
    simplest,
    told_from_none,
    weight_of,
)
from experiments.measurement.selection.elsewhere import Elsewhere

RIVAL = 0.2  # of an effect's linear score: others that have less do not explain the same


class Refuted(NamedTuple):
    """An effect that explains some of the logs and, learned there, makes another one worse."""

    effect: str
    where: str
    log: str


class Choice(NamedTuple):
    """A round's winner and the rivals that fit as well; `sure` where it is told from none, or explains most."""

    winner: Finalist
    rivals: list[Finalist]
    sure: bool


class Judge(NamedTuple):
    """What finalists are judged on: the fit before them, and blocks (masks per log) that they were not fitted to."""

    logs: Sequence[Evidence]
    before: Refitted
    test: Masks
    elsewhere: Elsewhere
    refuted: list[Refuted]

    def choice(self, finalists: Sequence[Finalist]) -> Choice | None:
        """The winner and its rivals: proven on held-out blocks and, of several logs, not refuted by one left out whole.

        Where so much is left that all intervals are wide, an effect may wait for a later one to tell it from none.
        """
        finalists = [f for f in finalists if not at_end_of_shape(f.scored.effect, f.fit)]
        told = [self._told(f, finalists) for f in finalists]
        chosen = self._simplest([f for f, is_told in zip(finalists, told, strict=True) if is_told], sure=True)
        if chosen is not None:
            return chosen
        others = [f for f, is_told in zip(finalists, told, strict=True) if not is_told]
        return self._simplest([f for f in others if self._loud(f)], sure=False)

    def _told(self, f: Finalist, finalists: Sequence[Finalist]) -> bool:
        return told_from_none(f.scored.effect, f.fit) or plain(*self._asked(f)) or self._alone(f, finalists)

    def _alone(self, f: Finalist, finalists: Sequence[Finalist]) -> bool:
        """Whether an effect explains most of what is left where it acts, and no other one comes near its score.

        Few rows tell of a ground's slope or friction: nominal numbers that such rows also move widen its interval.
        """
        others = [g.scored.gain for g in finalists if g.scored.effect is not f.scored.effect]
        if f.scored.gain < max(CLEAR_GAIN, max(others, default=0.0) / RIVAL):
            return False
        left = left_at(f.scored.effect, f.scored.where, self.logs, self.before, self.test)
        return chi2_on(self.before, self.test) - f.held_out > MOST * left

    def _loud(self, f: Finalist) -> bool:
        return loud(f.scored.effect, f.scored.where, self.before, self.logs, self.test)

    def _asked(self, f: Finalist) -> tuple:
        return f.scored.effect, f.scored.where, self.before, f.held_out, self.logs, self.test

    def _simplest(self, finalists: list[Finalist], sure: bool) -> Choice | None:
        """Of finalists, best first. One that explains more of the whole robot's noise than the winner, but too little
        of its own parts', is no rival."""
        there = [proven(*self._asked(f)) for f in finalists]
        if not any(there):
            return None
        noise, names = weight_of(self.logs, self.test), self.logs[0].atoms.joint_names
        winner, rivals = simplest(finalists[there.index(True) :], chi2_on(self.before, self.test), noise, names)
        close = [winner, *rivals]
        for one in close:
            log = self.elsewhere.refutes(one.fit.effects, one.fit)
            if log is None:
                return Choice(one, [other for other in close if other is not one], sure)
            self.refuted.append(Refuted(one.scored.effect.name, one.scored.where, log))
        return None
