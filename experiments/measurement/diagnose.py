"""`starleth diagnose`: which physical effect does the model lack, where, how sure, what else could it be?"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from experiments.effects.effect import Effect
from experiments.measurement.answer import answer_of
from experiments.measurement.evidence.gather import gather
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Placed
from experiments.measurement.fits.misfit import Misfit, misfit
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.noise_floor import noise_of
from experiments.measurement.next_experiment import NextExperiment, next_experiment
from experiments.measurement.selection.judged_rows import set_aside
from experiments.measurement.selection.ladder import Selection
from experiments.measurement.selection.leftover import Hint, hints
from experiments.measurement.selection.pruning import take_out_unsteady
from experiments.measurement.selection.stages import selected
from experiments.measurement.selection.verdict import (
    WHOLE,
    Verdict,
    decide,
    effect_entries,
    fit_percents,
    held_out_error,
    held_out_rms,
    ranking_entries,
    unexplained,
)
from experiments.model import Model

HINTS_TOLD = 2  # in the verdict's words; the answer file and the report hold more


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
    evidence, selection = selected(whole, model, say)
    take_out_unsteady(selection, evidence, say)
    verdict, effects = decide(evidence, selection)
    before = tuple(misfit(log, selection.ladder[0].fit, i) for i, log in enumerate(evidence))
    after = tuple(misfit(log, selection.fit, i) for i, log in enumerate(evidence))
    rest = hints(evidence, selection.fit if effects else selection.ladder[0].fit)
    text = f"{in_words(verdict, effects, selection, evidence, rest)} {set_aside(whole, evidence)}".rstrip()
    further = next_experiment(evidence, selection, model)
    told = _answer(verdict, effects, selection, evidence, text, further.text, rest)
    return Diagnosis(verdict, effects, selection, evidence, before, after, text, further, tuple(rest), told)


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
    }[verdict]
    told = [verdict_text, *_less_sure(verdict, selection, logs), *(log.not_judged for log in logs if log.not_judged)]
    for one in selection.refuted:
        told.append(
            f"{one.effect} at {one.where} explains some of the logs and makes {one.log} worse: "
            "are they of one robot in one state?"
        )
    told += [f"{one.in_words()}: no law of the library does, so it is not named." for one in selection.unsteady]
    if verdict not in ("none", "explained") and rest:
        told.append(f"Of what is left, {', and '.join(hint.in_words() for hint in rest[:HINTS_TOLD])}.")
    return " ".join(told)


def _less_sure(verdict: Verdict, selection: Selection, logs: Sequence[Evidence]) -> list[str]:
    """That what explains all of a log, fitted to half of it, does not explain the other half; empty where it does."""
    held_out = held_out_error(logs, selection.ladder[-1].proof) if verdict == "explained" else 0.0
    if held_out <= WHOLE:
        return []
    return [
        f"Fitted to half of it, it leaves {held_out:.1f} times the noise in the worst channel of the other half: its "
        "numbers may be farther off than their intervals say."
    ]


def _answer(verdict, effects, selection: Selection, logs, text: str, further: str, rest) -> dict[str, Any]:
    units = {(e.name, p.name): p.unit for e in logs[0].atoms.effects for p in e.parameters}
    fits = fit_percents(selection, logs)
    told = answer_of(
        verdict,
        text,
        further,
        effects=effect_entries(selection, logs, units) if effects else [],
        tied_with=[[name for name, _ in group] for group in selection.ties] if effects else [],
        held_out_rms=held_out_rms(selection, logs),
        unexplained_fraction=unexplained(logs, selection),
        ranking=ranking_entries(selection, logs),
        refuted=[one._asdict() for one in selection.refuted],
        unsteady=[one._asdict() for one in selection.unsteady],
        rest_goes_with=[hint._asdict() for hint in rest],
    )
    return told | ({"fit_percent": fits} if fits else {})
