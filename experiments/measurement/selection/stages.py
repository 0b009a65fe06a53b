"""The stages of a selection: the nominal numbers as they stand, those a little off, effects beside either."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fits.misfit import above_floor, excess
from experiments.measurement.fits.nominal import (
    all_inexact,
    as_far_as_others,
    at_end,
    never_given,
    nominal_freedom,
    numbers_among,
)
from experiments.measurement.fits.refit import refit
from experiments.measurement.selection.as_numbers import as_numbers
from experiments.measurement.selection.belief import LEAST_GAIN, LEAST_STEP
from experiments.measurement.selection.judged_rows import Judged, judged_rows
from experiments.measurement.selection.ladder import Selection
from experiments.measurement.selection.select import MOST_EFFECTS, NEGLIGIBLE, NOISE, leaves_more, select
from experiments.measurement.selection.verdict import unexplained
from experiments.model import Model

WELL_EXPLAINED = 0.02  # excess of chi^2 per residual at which the nominal numbers need no second look
CLEARLY_LESS = 0.8  # of the excess, that free numbers have to leave at most where they need as many effects
SEVERAL = 2  # effects that may be nominal numbers, from which a robot's numbers are off rather than all these missing
LITTLE = 0.005  # of what the nominal model leaves: effects that leave no more beside free numbers are what is missing
ROUGH = 0.1  # of the misfit: by how much replays may be off where next to nothing decides
PROMISING = 0.5  # of the excess: with the nominal numbers as they stand, each effect has to explain most of the rest


def selected(
    evidence: tuple[Evidence, ...], model: Model, say: Callable[[str], None]
) -> tuple[tuple[Evidence, ...], Selection]:
    """With the nominal numbers as they stand if that explains the logs, else with numbers that may be a little off.

    A log that slightly different numbers explain lacks no effect, and one that few effects explain with the nominal
    numbers, each most of what is left, needs no others. What no model has and every robot does is free from the start.
    """
    standing = any(log.standing for log in evidence)
    freedom = nominal_freedom(model, evidence[0].atoms.effects, standing)
    given = never_given(model, evidence[0].atoms.effects)
    freedom = (*given, *(n for n in freedom if n not in given))
    strict = select(evidence, given, say, most=0)
    if excess(evidence, strict.fit) <= WELL_EXPLAINED:
        if above_floor(evidence, strict.fit) > 0:
            return evidence, select(evidence, given, say, 1, promising=LEAST_STEP, begun=strict.ladder[0])
        alone = select(evidence, given, say, 1, least=WELL_EXPLAINED, begun=strict.ladder[0])
        if not alone.fit.effects:
            return evidence, alone
        return evidence, _freed(evidence, freedom, _numbers(evidence, freedom, say), say)
    if all(log.rigid for log in evidence):  # where a gain is all of the numbers in one
        numbers = select(evidence, freedom, say, most=0)
        if excess(evidence, numbers.fit) <= WELL_EXPLAINED:
            return evidence, numbers
    # what explains one of several logs has to be refuted
    most, promising = (MOST_EFFECTS, PROMISING) if len(evidence) == 1 else (1, 0.0)
    strict = select(evidence, given, say, most, promising=promising, begun=strict.ladder[0])
    tiny = NEGLIGIBLE * excess(evidence, strict.ladder[0].fit)
    well = excess(evidence, strict.fit) <= max(WELL_EXPLAINED, tiny) and not leaves_more(evidence, strict)
    numbers_off = len(numbers_among(strict.fit.effects, freedom)) >= SEVERAL or all_inexact(strict.fit.effects, freedom)
    if well and not numbers_off:
        return evidence, strict

    def strictly_again(judged: Judged) -> Selection:
        return select(judged.logs, given, say, most, promising=promising, begin=judged.effects)

    told = _where_told(evidence, strict, strictly_again)
    if told is not None:
        evidence, strict = told
        if len(strict.fit.effects) == 1:
            return told
    numbers = _numbers(evidence, freedom, say)
    kept = as_numbers(evidence, strict, freedom, numbers)
    little = max(WELL_EXPLAINED, LITTLE * excess(evidence, strict.ladder[0].fit))
    if kept is not None and excess(evidence, kept.fit) <= little:
        return evidence, kept
    freed = _freed(evidence, freedom, numbers, say, () if told is None else strict.fit.effects)
    if told is None:

        def freed_again(judged: Judged) -> Selection:
            return _freed(judged.logs, freedom, _numbers(judged.logs, freedom, say), say, judged.effects)

        further = _where_told(evidence, freed, freed_again)
        if further is not None:
            return further
    return evidence, freed if _better(evidence, freed, strict) else strict


def _where_told(
    evidence: tuple[Evidence, ...], selection: Selection, again: Callable[[Judged], Selection]
) -> tuple[tuple[Evidence, ...], Selection] | None:
    """The logs without the rows that by a selection no replay tells, and the selection made again on them; None
    where there are no such rows, or no effect explains the others roughly."""
    judged = judged_rows(evidence, selection)
    if judged is None:
        return None
    found = again(judged)
    return (judged.logs, found) if found.fit.effects and unexplained(judged.logs, found) < ROUGH else None


def _numbers(logs: tuple[Evidence, ...], freedom: Sequence[Nominal], say: Callable[[str], None]) -> Refitted:
    """Numbers that may be a little off, and no effect."""
    say("trying again with nominal numbers that may be a little off")
    return refit(logs, (), freedom)


def _freed(
    logs: tuple[Evidence, ...],
    freedom: Sequence[Nominal],
    free: Refitted,
    say: Callable[[str], None],
    begin: Sequence[Placed] = (),
) -> Selection:
    """Effects beside free numbers that may be off as far as the others of this robot are.

    No effects where all that are found are no larger than numbers are exact: so much may drives of a kind differ.
    """
    wide, freedom = freedom, as_far_as_others(freedom, free)
    numbers = select(logs, freedom, say, most=0, start=free)
    # numbers that had to go as far as they may do not explain a log well, however little is left; nor where one part
    # of the plant stays above its floor
    ill = at_end(freedom, numbers.fit) or above_floor(logs, numbers.fit) > LEAST_GAIN
    least = NOISE if ill else WELL_EXPLAINED
    found = select(logs, freedom, say, least=least, begun=numbers.ladder[0], begin=begin)
    if not all_inexact(found.fit.effects, wide):
        return found
    return replace(numbers, rankings=found.rankings, refitted=found.refitted, refuted=found.refuted)


def _better(logs: Sequence[Evidence], freed: Selection, strict: Selection) -> bool:
    """Whether freeing the nominal numbers explains more, or as much with fewer effects and no number at its end, or
    finds an effect where the nominal numbers hid all."""
    if freed.fit.effects and not strict.fit.effects:
        return True
    if len(freed.fit.effects) < len(strict.fit.effects) and not at_end(freed.nominal, freed.fit):
        return excess(logs, freed.fit) < max(excess(logs, strict.fit), 2.0 * WELL_EXPLAINED)
    return excess(logs, freed.fit) < CLEARLY_LESS * excess(logs, strict.fit)
