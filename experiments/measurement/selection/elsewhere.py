"""Proof on another experiment: each of several logs is left out whole, and what the others teach is tried on it.

An effect that is there acts in every motion. One that only imitates it is fitted to the motions that it was fitted to,
and makes a motion that it has not seen worse.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fits.refit import SHORT_FIT, refit, settle
from experiments.measurement.fits.side_by_side import side_by_side

LEARNED = 40.0  # fall of chi^2 on the other logs from which they teach anything about an effect
WORSE = 0.01  # of the unseen log's noise variance, by which an imitation makes it worse


class Try(NamedTuple):
    """What all logs but one teach, and what that leaves of the one."""

    taught: Refitted  # the others
    unseen: Refitted  # the one


class Proof(NamedTuple):
    """One effect on one log that it was not fitted to: the log as fitted without it and with it."""

    log: str
    index: int
    before: Refitted
    after: Refitted

    @property
    def gain(self) -> float:
        """Fall of chi^2."""
        return self.before.total - self.after.total


@dataclass
class Elsewhere:
    """Tries of sets of effects; each set is fitted once."""

    logs: Sequence[Evidence]
    nominal: Sequence[Nominal]
    known: dict[tuple[tuple[str, str], ...], tuple[Try, ...]] = field(default_factory=dict)

    def tries(self, effects: Sequence[Placed], start: Refitted) -> tuple[Try, ...]:
        """One for each log, none where there is only one; effects start from where a fit to all logs has them."""
        key = tuple((p.effect, p.where) for p in effects)
        if key not in self.known:
            each = range(len(self.logs)) if len(self.logs) > 1 else ()
            self.known[key] = tuple(side_by_side(lambda k: self._without(k, effects, start), each))
        return self.known[key]

    def proofs(self, effects: Sequence[Placed], start: Refitted) -> list[Proof]:
        """The last of these effects on each log about which the others teach it."""
        pairs = zip(self.tries(effects[:-1], start), self.tries(effects, start), strict=True)
        return [
            Proof(self.logs[k].name, k, before.unseen, after.unseen)
            for k, (before, after) in enumerate(pairs)
            if before.taught.total - after.taught.total > LEARNED
        ]

    def refutes(self, effects: Sequence[Placed], start: Refitted) -> str | None:
        """The log that the last of these effects, learned on the others, makes worse; None if it makes none."""
        for proof in self.proofs(effects, start):
            if -proof.gain > max(LEARNED, WORSE * self.logs[proof.index].weight().sum()):
                return proof.log
        return None

    def _without(self, k: int, effects: Sequence[Placed], start: Refitted) -> Try:
        others = [i for i in range(len(self.logs)) if i != k]
        seen = replace(start, points=tuple(start.points[i] for i in others))
        taught = refit([self.logs[i] for i in others], effects, self.nominal, seen, iterations=SHORT_FIT)
        return Try(taught, settle(self.logs[k], taught, self.nominal))
