"""`starleth learn`: put effects into the model file, fitted to logs, with intervals."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

import numpy as np

from experiments.effects.effect import Effect
from experiments.effects.library import find_effect
from experiments.effects.places import mask
from experiments.errors import UserError
from experiments.measurement.evidence.features import changes_of
from experiments.measurement.evidence.gather import gather
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fits.misfit import misfit
from experiments.measurement.fits.nominal import NOT_GIVEN, never_given, nominal_freedom
from experiments.measurement.fits.refit import refit
from experiments.measurement.learned import with_learned
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.noise_floor import noise_of
from experiments.measurement.selection.linear_score import score
from experiments.model import Model


def parse_place(text: str, library: Mapping[str, Effect], joint_names: Sequence[str]) -> tuple[str, str]:
    """`backlash@LH_KFE` as (effect, place); the widest place where none is given. Raises UserError."""
    name, _, where = text.partition("@")
    effect = find_effect(name, dict(library))
    where = where or {"torso": "torso", "foot": "feet", "ground": "feet"}.get(effect.axis, "all")
    if where == "all" and len(joint_names) == 1:
        where = joint_names[0]
    try:
        mask(where, effect.axis, tuple(joint_names))
    except ValueError as error:
        raise UserError(f"{error}.") from None
    return name, where


def learn(
    logs: Sequence[Log],
    model: Model,
    library: Mapping[str, Effect],
    wanted: Sequence[tuple[str, str]],
    nominal: bool = False,
) -> Model:
    """The model with the wanted effects, fitted; effects that it has already stay, and add to what is learned where
    their places overlap, unless they are wanted again.

    nominal: fit the robot's nominal numbers beside them, within what a data sheet may be off by.
    """
    kept = tuple(e for e in model.effects if (e.effect, e.where) not in set(wanted))
    model = model.model_copy(update={"effects": kept})
    used = {e.effect: library[e.effect] for e in kept} | {name: library[name] for name, _ in wanted}
    standing = any(log.experiment == "ground" for log in logs)
    freedom = nominal_freedom(model, tuple(library.values()), standing) if nominal else ()
    freedom = tuple(n for n in freedom if n.effect not in NOT_GIVEN)
    used |= {n.effect: library[n.effect] for n in freedom}
    evidence = [gather(log, model, used, noise_of(log)) for log in logs]
    others = never_given(model, evidence[0].atoms.effects)
    start = _starts(evidence, wanted, others)
    fit = refit(evidence, start, (*freedom, *others))
    _refuse_untold(evidence, fit)
    record = {
        "when": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "logs": [log.name for log in logs],
        "effects": [f"{p.effect}@{p.where}" for p in fit.effects],
        "worst_error_over_noise": [round(misfit(e, fit, i).worst, 3) for i, e in enumerate(evidence)],
    }
    # others are not learned: the clock is the log's, and the simulated drives have bearings of their own
    model = with_learned(model, evidence[0].atoms, fit, freedom)
    return model.model_copy(update={"provenance": (*model.provenance, record)})


def _refuse_untold(evidence: Sequence[Evidence], fit: Refitted) -> None:
    """Raise UserError where no number of an effect changes anything that the logs show: there a fit is a guess."""
    told, first = np.diag(fit.covariance) > 0.0, 0
    for placed in fit.effects:
        its = told[first : first + len(placed.parameters)]
        first += len(placed.parameters)
        if not its.any():
            names = " and ".join(log.name for log in evidence)
            raise UserError(
                f"{names}: nothing logged tells of {placed.effect} at {placed.where}; record a motion in which it acts."
            )


def _starts(evidence: Sequence[Evidence], wanted: Sequence[tuple[str, str]], others: Sequence[Nominal]) -> list[Placed]:
    """Start values: what the linear score suggests for each effect at its place, or what is plausible where an effect
    is never scored."""
    known = {effect.name: effect for effect in evidence[0].atoms.effects}
    empty = refit(evidence, (), others, iterations=2)
    changes, variants = changes_of(evidence[0].atoms.effects, evidence, empty.points)
    scored = {(s.effect.name, s.where): s for s in reversed(score(evidence, empty, others, changes, variants))}
    plausible = lambda name: {p.name: p.start for p in known[name].parameters}  # noqa: E731
    return [Placed(n, w, scored[n, w].values if (n, w) in scored else plausible(n)) for n, w in wanted]
