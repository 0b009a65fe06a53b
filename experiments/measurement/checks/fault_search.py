"""Which faults, undone, make the columns of a log agree with one another.

Greedy: of all hypotheses take the one that makes the links between columns more likely by most, undo it, look again.
An effect of physics is not undone by exchanging, flipping, rescaling or shifting whole columns, so it stays.
"""

import math
from collections import ChainMap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import numpy as np

from experiments.measurement.checks import hypotheses, repairs
from experiments.measurement.checks.base_links import base_links
from experiments.measurement.checks.hypotheses import Doubts
from experiments.measurement.checks.joint_links import bench_links, joint_links
from experiments.measurement.checks.leg_links import air_links, ground_links
from experiments.measurement.checks.links import GAIN, Column, Link, usable_columns
from experiments.measurement.checks.matching import Array, Match
from experiments.measurement.checks.posture import Posture, posture
from experiments.measurement.checks.repairs import Repair
from experiments.measurement.checks.unrelated import unrelated
from experiments.measurement.logs.log import Log
from mjx_starleth.names import JOINT_NAMES, LEGS

AnyLink = Link | Posture

# Nats of likelihood. Chance gives about one; what a model's error may give is kept small by the links' floors.
_LEAST_EVIDENCE: Final = 30.0
_WORSE: Final = -10.0  # a true repair makes nothing else worse
_EXTRA_SIGNAL: Final = 5.0  # of two that explain as much, the one that touches fewer signals
# A repair has to cut the misfit (and floor) of one link at least by this; of a shift in slow motion less is to be had
_LEAST_RATIO: Final = 3.0
_LEAST_SHIFT_RATIO: Final = 2.0
_LEAST_WRONG: Final = 0.6  # misfit of a link with a sign turned, or a unit of more than 7 times the right one
_OF_EXPECTED: Final = 0.8  # of the misfit that a known unit makes, if that is less
_MENDED: Final = 0.1  # misfit that is left by the right repair; hysteresis and play leave more, whatever is shifted
_BROKEN: Final = 0.1  # misfit that exchanged, flipped and rescaled columns leave at least
_ALL_EXPLAINED: Final = 0.9  # of what a repair can bring to the links that it touches
_FURTHER_LAG: Final = 15.0  # nats by which a longer shift must beat one that an effect may have
# A true shift brings 0.19 and more of what its links could gain; beside a delay of sensors others bring up to 0.13
_LEAST_SHARE: Final = 0.17
# Columns exchanged back mend both joints; those of a joint at rest, exchanged with any other's, bring 0.02 in all
_LEAST_SWAP_SHARE: Final = 0.17
_AS_MUCH: Final = 5.0  # nats between shifts that explain the same
_MOST_LAG: Final = 60.0  # samples searched
_MOST_REPAIRS: Final = 40


@dataclass(frozen=True)
class Finding:
    """A repair that was made, and what it brought."""

    repair: Repair
    nats: float
    share: float  # of what the links that it touches could gain at all


def links_of(log: Log, columns: Mapping[Column, Array], numbers: Mapping[str, Any]) -> list[AnyLink]:
    """All links that the columns of this log allow."""
    period = log.sample_period
    if log.joint is not None:
        return list(bench_links(log.joint, columns, period))
    links: list[AnyLink] = []
    for joint in JOINT_NAMES:
        links += joint_links(joint, columns, period, numbers)
        if ("joint_position", joint) in columns:
            links.append(posture(joint, numbers))
    for leg in LEGS:
        leg_links = air_links if log.experiment == "fixed_base" else ground_links
        links += leg_links(leg, columns, period, numbers)
    return links + list(base_links(columns, period, numbers))


def _least_wrong(repair: Repair) -> float:
    """The misfit that a link has to have before this repair of it is believed."""
    if repair.kind not in ("sign", "unit"):
        return 0.0
    if repair.kind == "sign":
        return _LEAST_WRONG
    # a term that is `value` times too large or too small, at the gain that comes nearest
    seen = repair.value * float(np.clip(1.0 / repair.value, *GAIN))
    return min(_LEAST_WRONG, _OF_EXPECTED * (1.0 - 2.0 * seen / (1.0 + seen**2)))


class FaultSearch:
    """The columns as repaired so far, and how well each link holds."""

    def __init__(self, log: Log, numbers: Mapping[str, Any]):
        self.period = log.sample_period
        self.columns: dict[Column, Array] = usable_columns(log)
        self.links = links_of(log, self.columns, numbers)
        self.gear_ratio = 100.0 if log.joint is not None else float(numbers["drive"]["gear_ratio"])
        self.names = log.joint_names
        self.matches = {
            still: [self._match(link, self.columns, still) for link in self.links] for still in (False, True)
        }
        self._known: dict[tuple[Any, ...], tuple[frozenset[int], Finding | None]] = {}
        self._touching: dict[Column, list[int]] = {}
        for place, link in enumerate(self.links):
            for column in link.columns:
                self._touching.setdefault(column, []).append(place)

    def run(self) -> list[Finding]:
        """Repairs, the most convincing first, until nothing more is convincing."""
        findings: list[Finding] = []
        while len(findings) < _MOST_REPAIRS and (found := self._best()):
            self._apply(found.repair)
            findings.append(found)
        return findings or self._unrelated()

    def _unrelated(self) -> list[Finding]:
        """Columns that no repair makes agree with the others."""
        matches = self.matches[False]
        return [
            Finding(Repair("unrelated", (signal,), (name,), 0.0, {}), 0.0, 0.0)
            for signal, name in unrelated(self.links, matches, self.columns, self.period)
        ]

    def _match(self, link: AnyLink, columns: Mapping[Column, Array], still: bool) -> Match:
        """`still`: with hardly any delay, so that a shift makes a difference."""
        return (link.still_match if still else link.match)(columns, self.period)

    def _broken(self) -> Doubts:
        """Columns of links that do not hold at all."""
        broken = zip(self.links, self.matches[False], strict=True)
        return Doubts({column for link, match in broken if match.misfit > _BROKEN for column in link.columns}, {})

    def _late(self) -> Doubts:
        """Columns of links that do not quite hold, and the lags at which they hold better."""
        columns, lags = set(), {}
        for link, match in zip(self.links, self.matches[True], strict=True):
            if match.misfit <= link.floor:
                continue
            columns.update(link.columns)
            free = link.free_match(self.columns, self.period, _MOST_LAG)
            if free.misfit < 0.5 * match.misfit:
                for _, name in link.columns:
                    lags.setdefault(name, set()).add(round(free.lag))
        return Doubts(columns, lags)

    def evidence(self, repair: Repair) -> Finding | None:
        """What a repair brings, None if it makes anything worse; kept until a link that it touches changes."""
        key = (repair.kind, repair.signals, repair.names, repair.value)
        if key not in self._known:
            self._known[key] = (frozenset(self._touched(repair)), self._evidence(repair))
        return self._known[key][1]

    def _evidence(self, repair: Repair) -> Finding | None:
        changed, still = ChainMap(repair.applied(self.columns), self.columns), repair.kind == "time_shift"
        total, possible, best = 0.0, 0.0, (1.0, 1.0, 1.0)
        for place in self._touched(repair):
            link, before = self.links[place], self.matches[still][place]
            after = self._match(link, changed, still)
            ratio = (before.misfit + link.floor) / (after.misfit + link.floor)
            total += 0.5 * before.freedom * math.log(ratio)
            possible += 0.5 * before.freedom * math.log(1.0 + before.misfit / link.floor)
            best = max(best, (ratio, before.misfit, after.misfit))
            if total < _WORSE:
                return None
        share = total / possible if possible > 0 else 0.0
        total -= _EXTRA_SIGNAL * (len(repair.signals) - 1)
        ratio, before, after = best
        least = _LEAST_SHIFT_RATIO if still else _LEAST_RATIO
        if repair.kind == "swapped_joints" and share < _LEAST_SWAP_SHARE:
            return None
        wrong = before >= _least_wrong(repair)
        return Finding(repair, total, share) if ratio >= least and wrong and after <= _MENDED else None

    def _best(self) -> Finding | None:
        values = self._found(hypotheses.of_values(self._broken(), self.names, self.columns, self.gear_ratio))
        if values and values[0].share > _ALL_EXPLAINED:
            return values[0]  # no need to look for shifts, which takes longest
        # a lone joint on a bench shows too little to tell a shifted column from a controller that lags behind
        shifts = self._found(hypotheses.of_time(self._late(), self.names, self.columns)) if len(self.names) > 1 else []
        for finding in sorted(values + shifts, key=lambda finding: -finding.nats):
            refined = self._best_shift(finding) if finding.repair.kind == "time_shift" else finding
            if refined is not None:
                return refined
        return None

    def _found(self, candidates: Iterable[Repair | None]) -> list[Finding]:
        """What convinces, the best first."""
        found = [finding for repair in candidates if repair and (finding := self.evidence(repair))]
        return sorted((one for one in found if one.nats >= _LEAST_EVIDENCE), key=lambda finding: -finding.nats)

    def _best_shift(self, finding: Finding) -> Finding | None:
        """The best of the neighbouring shifts; a long one only if no short one does nearly as well."""
        repair = finding.repair

        def tried(late: int) -> Finding | None:
            other = repairs.shift(repair.signals, repair.names, late, self.columns)
            return self.evidence(other) if other and late else None

        while True:
            step = [tried(int(finding.repair.value) + one) for one in (-1, 1)]
            better = [one for one in step if one and one.nats > finding.nats]
            if not better:
                break
            finding = max(better, key=lambda one: one.nats)
        if hypotheses.is_effect(finding.repair) or finding.share < _LEAST_SHARE:
            return None
        short = [one.nats for late in hypotheses.EFFECT_LAGS if (one := tried(late))]
        if finding.nats - max(short, default=0.0) < _FURTHER_LAG:
            return None
        # links allow a sample of delay: of neighbours that explain as much, the one that needs none
        value = int(finding.repair.value)
        near = [one for late in (value, value - 1, value + 1) if (one := tried(late))]
        alike = [one for one in near if finding.nats - one.nats < _AS_MUCH]
        return min(alike, key=lambda one: self._left(one.repair))

    def _left(self, repair: Repair) -> float:
        """Delay that the links which a shift mends still have, in samples."""
        changed = ChainMap(repair.applied(self.columns), self.columns)
        lags = []
        for place in self._touched(repair):
            after = self._match(self.links[place], changed, True)
            if after.misfit <= _MENDED:
                lags.append(abs(after.lag))
        return float(np.median(lags)) if lags else 0.0

    def _apply(self, repair: Repair) -> None:
        self.columns |= repair.applied(self.columns)
        changed = self._touched(repair)
        self._known = {key: known for key, known in self._known.items() if known[0].isdisjoint(changed)}
        for still, place in product((False, True), changed):
            self.matches[still][place] = self._match(self.links[place], self.columns, still)

    def _touched(self, repair: Repair) -> list[int]:
        """Links to look at again; those of a whole leg last, for they take longest."""
        return sorted({place for column in repair.changes for place in self._touching.get(column, ())})
