"""`starleth diagnose`: which physical effect does the model lack, where, how sure, what else could it be?"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from experiments.effects.effect import Effect
from experiments.measurement.evidence.gather import gather
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Nominal, Placed
from experiments.measurement.fits.misfit import Misfit, above_floor, excess, misfit
from experiments.measurement.fits.nominal import (
    as_far_as_others,
    at_end,
    never_given,
    nominal_freedom,
    numbers_among,
)
from experiments.measurement.fits.refit import refit
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.noise_floor import noise_of
from experiments.measurement.next_experiment import NextExperiment, next_experiment
from experiments.measurement.selection.belief import LEAST_GAIN, LEAST_STEP
from experiments.measurement.selection.judged_rows import judged_rows, set_aside
from experiments.measurement.selection.ladder import Selection
from experiments.measurement.selection.leftover import Hint, hints
from experiments.measurement.selection.pruning import take_out_unsteady
from experiments.measurement.selection.select import MOST_EFFECTS, NEGLIGIBLE, NOISE, leaves_more, select
from experiments.measurement.selection.verdict import (
    Verdict,
    decide,
    effect_entries,
    fit_percents,
    held_out_rms,
    ranking_entries,
    unexplained,
)
from experiments.model import Model

HINTS_TOLD = 2  # in the verdict's words; the answer file and the report hold more
WELL_EXPLAINED = 0.02  # excess of chi^2 per residual at which the nominal numbers need no second look
CLEARLY_LESS = 0.8  # of the excess, that free numbers have to leave at most where they need as many effects
SEVERAL = 2  # effects that may be nominal numbers, from which a robot's numbers are off rather than all these missing
ROUGH = 0.1  # of the misfit: by how much replays may be off that noise decides in places
PROMISING = 0.5  # of that excess: with the nominal numbers as they stand, each effect has to explain most of the rest


@dataclass(frozen=True)
class Diagnosis:
    """What was found in one or several logs."""

    verdict: Verdict
    effects: tuple[Placed, ...]
    selection: Selection | None
    logs: tuple[Evidence, ...]
    before: tuple[Misfit, ...]
    after: tuple[Misfit, ...]
    text: str
    next_experiment: NextExperiment
    rest: tuple[Hint, ...]
    answer: dict[str, Any]


def diagnose(logs: Sequence[Log], model: Model, library: Mapping[str, Effect], say: Callable[[str], None]) -> Diagnosis:
    """The whole method. Raises UserError for logs that cannot be used at all."""
    say("replaying the logs")
    return diagnose_evidence(tuple(gather(log, model, library, noise_of(log)) for log in logs), model, say)


def diagnose_evidence(evidence: tuple[Evidence, ...], model: Model, say: Callable[[str], None]) -> Diagnosis:
    """The method on logs that are gathered already."""
    whole = evidence
    evidence, selection = _selected(whole, model, say)
    take_out_unsteady(selection, evidence, say)
    verdict, effects = decide(evidence, selection)
    before = tuple(misfit(log, selection.ladder[0].fit, i) for i, log in enumerate(evidence))
    after = tuple(misfit(log, selection.fit, i) for i, log in enumerate(evidence))
    rest = hints(evidence, selection.fit if effects else selection.ladder[0].fit)
    text = f"{in_words(verdict, effects, selection, evidence, rest)} {set_aside(whole, evidence)}".rstrip()
    further = next_experiment(evidence, selection, model)
    answer = _answer(verdict, effects, selection, evidence, text) | {"next_experiment": further.text}
    answer["rest_goes_with"] = [hint._asdict() for hint in rest]
    return Diagnosis(verdict, effects, selection, evidence, before, after, text, further, tuple(rest), answer)


def _selected(
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
        return evidence, _freed(evidence, freedom, say) if alone.fit.effects else alone
    if all(log.rigid for log in evidence):  # where a gain is all of the numbers in one
        numbers = select(evidence, freedom, say, most=0)
        if excess(evidence, numbers.fit) <= WELL_EXPLAINED:
            return evidence, numbers
    # what explains one of several logs has to be refuted
    most, promising = (MOST_EFFECTS, PROMISING) if len(evidence) == 1 else (1, 0.0)
    strict = select(evidence, given, say, most, promising=promising, begun=strict.ladder[0])
    tiny = NEGLIGIBLE * excess(evidence, strict.ladder[0].fit)
    well = excess(evidence, strict.fit) <= max(WELL_EXPLAINED, tiny) and not leaves_more(evidence, strict)
    if well and len(numbers_among(strict.fit.effects, freedom)) < SEVERAL:
        return evidence, strict
    told = _where_told(evidence, strict, lambda logs: select(logs, given, say, most, promising=promising))
    if told is not None:
        evidence, strict = told
        if len(strict.fit.effects) == 1:
            return told
    freed = _freed(evidence, freedom, say)
    if told is None:
        further = _where_told(evidence, freed, lambda logs: _freed(logs, freedom, say))
        if further is not None:
            return further
    return evidence, freed if _better(evidence, freed, strict) else strict


def _where_told(
    evidence: tuple[Evidence, ...], selection: Selection, again: Callable[[tuple[Evidence, ...]], Selection]
) -> tuple[tuple[Evidence, ...], Selection] | None:
    """The logs without the rows that by a selection only noise decides, and the selection made again on them; None
    where there are no such rows, or no effect explains the others roughly."""
    judged = judged_rows(evidence, selection)
    if judged is None:
        return None
    found = again(judged)
    return (judged, found) if found.fit.effects and unexplained(judged, found) < ROUGH else None


def _freed(evidence: tuple[Evidence, ...], freedom: Sequence[Nominal], say: Callable[[str], None]) -> Selection:
    """With numbers that may be a little off, as far as the others of this robot are."""
    say("trying again with nominal numbers that may be a little off")
    free = refit(evidence, (), freedom)
    freedom = as_far_as_others(freedom, free)
    numbers = select(evidence, freedom, say, most=0, start=free)
    # numbers that had to go as far as they may do not explain a log well, however little is left; nor where one part
    # of the plant stays above its floor
    ill = at_end(freedom, numbers.fit) or above_floor(evidence, numbers.fit) > LEAST_GAIN
    least = NOISE if ill else WELL_EXPLAINED
    return select(evidence, freedom, say, least=least, begun=numbers.ladder[0])


def _better(logs: Sequence[Evidence], freed: Selection, strict: Selection) -> bool:
    """Whether freeing the nominal numbers explains more, or as much with fewer effects and no number at its end, or
    finds an effect where the nominal numbers hid all."""
    if freed.fit.effects and not strict.fit.effects:
        return True
    if len(freed.fit.effects) < len(strict.fit.effects) and not at_end(freed.nominal, freed.fit):
        return excess(logs, freed.fit) < max(excess(logs, strict.fit), 2.0 * WELL_EXPLAINED)
    return excess(logs, freed.fit) < CLEARLY_LESS * excess(logs, strict.fit)


def in_words(
    verdict: Verdict, effects: Sequence[Placed], selection: Selection, logs: Sequence[Evidence], rest: Sequence[Hint]
) -> str:
    """The verdict in plain words, and what the unexplained rest goes with."""
    named = " and ".join(f"{p.effect} at {p.where}" for p in effects)
    left = unexplained(logs, selection)
    ties = sorted({f"{name} at {where}" for group in selection.ties for name, where in group})
    verdict_text = {
        "none": "The model explains the log down to the sensors' noise: no effect is missing.",
        "explained": f"The model lacks {named}; with it the log is explained down to the noise.",
        "partly_explained": f"The model lacks {named}; {left:.1%} of the misfit remains that no known effect explains.",
        "not_identifiable": f"The model lacks {named}, or {', or '.join(ties)}: this motion cannot tell them apart.",
        "unknown": "Something is missing that no effect of the library explains.",
        "data_fault": "The log itself is faulty.",
    }[verdict]
    told = [verdict_text, *(log.not_judged for log in logs if log.not_judged)]
    for one in selection.refuted:
        told.append(
            f"{one.effect} at {one.where} explains some of the logs and makes {one.log} worse: "
            "are they of one robot in one state?"
        )
    told += [f"{one.in_words()}: no law of the library does, so it is not named." for one in selection.unsteady]
    if verdict not in ("none", "explained") and rest:
        told.append(f"Of what is left, {', and '.join(hint.in_words() for hint in rest[:HINTS_TOLD])}.")
    return " ".join(told)


def _answer(verdict, effects, selection: Selection, logs, text: str) -> dict[str, Any]:
    units = {(e.name, p.name): p.unit for e in logs[0].atoms.effects for p in e.parameters}
    fits = fit_percents(selection, logs)
    return {
        "verdict": verdict,
        "text": text,
        "effects": effect_entries(selection, logs, units) if effects else [],
        "tied_with": [[name for name, _ in group] for group in selection.ties] if effects else [],
        "next_experiment": "",
        "held_out_rms": round(held_out_rms(selection, logs), 4),
        "unexplained_fraction": round(unexplained(logs, selection), 4),
        "ranking": ranking_entries(selection, logs),
        "refuted": [one._asdict() for one in selection.refuted],
        "unsteady": [one._asdict() for one in selection.unsteady],
        **({"fit_percent": fits} if fits else {}),
    }
