"""The verdict: is the log explained, by what, how surely, and what is left? And the answer file that says so."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Placed, Refitted
from experiments.measurement.fits.misfit import FLOOR, QUIET, above_floor, excess, misfit
from experiments.measurement.selection.belief import halves, interval
from experiments.measurement.selection.joint_form import imitated
from experiments.measurement.selection.ladder import Selection
from experiments.measurement.selection.linear_score import best_of_each

Verdict = Literal["explained", "partly_explained", "none", "unknown", "not_identifiable"]

WHOLE = 1.5 * FLOOR  # residual over noise of the worst channel where effects explain a log: they have errors, too
FOUND_SHARE = 0.7  # of the excess over the floor that the effects must take away to be believed
LOUD, SHARE_OF_LOUD = 5.0 * QUIET, 0.05  # a rest so loud, and such a share of the misfit, has another law than these
LARGE = 0.2  # of the nominal excess: a smaller effect that has rivals does not make the verdict uncertain
NOTHING_LEFT = 5e-4  # of the misfit: it rounds to 0.0 %, however many noises of a strong effect that still is


def unexplained(logs: Sequence[Evidence], selection: Selection) -> float:
    """Share of the nominal model's excess that the fit leaves.

    What is above the channels' FLOOR counts: channels whose noise is a little larger than was thought would else be
    most of a misfit that one joint alone has.
    """
    before, after = above_floor(logs, selection.ladder[0].fit), above_floor(logs, selection.fit)
    return after / before if before > 0 else 0.0


def worst(logs: Sequence[Evidence], fit: Refitted) -> float:
    """The largest residual over noise of any channel of any log."""
    return max(misfit(log, fit, i).worst for i, log in enumerate(logs))


def decide(logs: Sequence[Evidence], selection: Selection) -> tuple[Verdict, tuple[Placed, ...]]:
    """The verdict and the effects that it names."""
    if _unknown_law(logs, selection):
        return "unknown", ()
    left = worst(logs, selection.fit)
    effects, quiet = selection.fit.effects, left <= QUIET
    if not effects:
        return ("none" if quiet else "unknown"), ()
    if not quiet and unexplained(logs, selection) > (SHARE_OF_LOUD if left > LOUD else 1.0 - FOUND_SHARE):
        return "unknown", ()
    if any(tied and _large(logs, selection, k) for k, tied in enumerate(selection.ties)):
        return "not_identifiable", effects
    whole = left <= WHOLE or unexplained(logs, selection) < NOTHING_LEFT
    return ("explained" if whole else "partly_explained"), effects


def _unknown_law(logs: Sequence[Evidence], selection: Selection) -> bool:
    """Whether a rigid joint follows a law of its position or speed that its effects, if any, at best imitate."""
    if not all(log.rigid for log in logs):
        return False
    without, found = selection.ladder[0].proof, selection.ladder[-1].proof
    return imitated(logs, selection.nominal, without, found, halves(logs)[0]) is not None


def _large(logs: Sequence[Evidence], selection: Selection, k: int) -> bool:
    """Whether the k-th effect took a large part of the nominal model's excess."""
    nominal, before, after = (excess(logs, selection.ladder[i].fit) for i in (0, k, k + 1))
    return before - after > LARGE * nominal


def effect_entries(
    selection: Selection, logs: Sequence[Evidence], units: dict[tuple[str, str], str]
) -> list[dict[str, Any]]:
    """`effects` of the answer file, in the order added."""
    found, first = [], 0
    for k, placed in enumerate(selection.fit.effects):
        parameters = {}
        for name, value in placed.parameters.items():
            ci95 = list(interval(selection.fit, first, value))
            parameters[name] = {"value": value, "ci95": ci95, "unit": units[placed.effect, name]}
            first += 1
        before, after = selection.ladder[k].proof, selection.ladder[k + 1].proof
        found.append(
            {
                "effect": placed.effect,
                "where": placed.where,
                "parameters": parameters,
                "held_out_error_before": held_out_error(logs, before),
                "held_out_error_after": held_out_error(logs, after),
                "other_experiments": other_experiments(selection, logs, k),
            }
        )
    return found


def other_experiments(selection: Selection, logs: Sequence[Evidence], k: int) -> list[dict[str, Any]]:
    """The k-th effect on each log that it was not fitted to, worst channel over noise without it and with it."""
    fit = selection.ladder[k + 1].proof
    return [
        {
            "log": proof.log,
            "error_before": round(misfit(logs[proof.index], proof.before, 0).worst, 3),
            "error_after": round(misfit(logs[proof.index], proof.after, 0).worst, 3),
        }
        for proof in selection.elsewhere.proofs(fit.effects, fit)
    ]


def held_out_error(logs: Sequence[Evidence], proof: Refitted) -> float:
    """Worst channel over noise on the blocks that a proof was not fitted to."""
    _, test = halves(logs)
    return max(misfit(log, proof, i, test[i]).worst for i, log in enumerate(logs))


def fit_percents(selection: Selection, logs: Sequence[Evidence]) -> list[dict[str, Any]]:
    """Of each bench log: share of the measured effort that each rung explains, %, on all and on held-out rows."""
    _, test = halves(logs)
    found = []
    for i, log in enumerate(logs):
        if log.rigid:
            here = test[i][log.part.block]
            for rung in selection.ladder:
                all_rows, held = log.fit_percent(rung.fit.points[i]), log.fit_percent(rung.proof.points[i], here)
                found.append(
                    {"log": log.name, "model": rung.name, "all": round(all_rows, 2), "held_out": round(held, 2)}
                )
    return found


def held_out_rms(selection: Selection, logs: Sequence[Evidence]) -> float:
    """RMS of all residuals over noise on the blocks that the last rung was not fitted to."""
    _, test = halves(logs)
    proof = selection.ladder[-1].proof
    total = sum((chi2 * blocks).sum() for chi2, blocks in zip(proof.chi2, test, strict=True))
    return float(np.sqrt(total / sum((log.weight() * blocks).sum() for log, blocks in zip(logs, test, strict=True))))


def refitted_rms(selection: Selection, logs: Sequence[Evidence]) -> dict[tuple[str, str], float]:
    """Effects that were refitted in the first round: RMS of all residuals over noise on held-out blocks."""
    _, test = halves(logs)
    weight = sum((log.weight() * blocks).sum() for log, blocks in zip(logs, test, strict=True))
    first = selection.refitted[0] if selection.refitted else []
    return {(f.scored.effect.name, f.scored.where): float(np.sqrt(f.held_out / weight)) for f in first}


def ranking_entries(selection: Selection, logs: Sequence[Evidence]) -> list[dict[str, Any]]:
    """`ranking` of the answer file: what was proven, then each effect at its best place by its first, linear score;
    of those that were refitted, what each alone leaves on held-out blocks."""
    if not selection.rankings:
        return []
    proven = {placed.effect: placed.where for placed in selection.fit.effects}
    first = [s for s in selection.rankings[0] if proven.get(s.effect.name) == s.where]
    order = [s for name in proven for s in first if s.effect.name == name][: len(proven)]
    order += [s for s in best_of_each(selection.rankings[0]) if s.gain > 0 and s.effect.name not in proven]
    refitted = refitted_rms(selection, logs)
    entries = []
    for s in order:
        entry = {"effect": s.effect.name, "where": s.where, "score": round(s.gain, 3)}
        rms = refitted.get((s.effect.name, s.where))
        entries.append(entry if rms is None else entry | {"held_out_rms": round(rms, 4)})
    return entries
