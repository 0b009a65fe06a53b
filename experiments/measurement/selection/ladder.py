"""The error ladder: what was selected, rung by rung, and all that was considered on the way."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.selection.belief import Finalist
from experiments.measurement.selection.choice import Refuted
from experiments.measurement.selection.elsewhere import Elsewhere
from experiments.measurement.selection.linear_score import Scored
from experiments.measurement.selection.steadiness import Change


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
    refitted: list[list[Finalist]] = field(default_factory=list)  # of each round
    refuted: list[Refuted] = field(default_factory=list)
    ties: list[list[tuple[str, str]]] = field(default_factory=list)
    winners: list[Refitted] = field(default_factory=list)
    rivals: list[list[Refitted]] = field(default_factory=list)  # of each winner, fitted as well as it
    sure: list[bool] = field(default_factory=list)  # of each winner, when it was chosen
    unsteady: list[Change] = field(default_factory=list)  # of effects that were taken out for it
    begin: Sequence[Placed] = ()  # effects as another fit has them, from where theirs begin

    def take_over(self, other: "Selection", k: int, rung: Rung) -> None:
        """Add the k-th effect of another selection, with what was kept of it, and its fit in this one."""
        self.ties.append(other.ties[k])
        self.winners.append(other.winners[k])
        self.rivals.append(other.rivals[k])
        self.sure.append(other.sure[k])
        self.ladder.append(rung)
        self.fit = rung.fit

    def forget(self, which: int | slice) -> None:
        """Drop what was kept of some effects beside the ladder."""
        for one in (self.ties, self.winners, self.rivals, self.sure):
            del one[which]
