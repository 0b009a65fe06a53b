"""The variables of a fit: parameters of effects and nominal numbers, their bounds and priors, their place in x."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from experiments.effects.effect import Effect
from experiments.effects.places import mask
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Nominal, Placed

FARTHEST = 2.0  # deviations that a nominal number may be off by: beyond them it is an effect and has to prove itself
PINNED = 1e-6  # of its deviation, that a number may be off by where an effect stands for it
DIFFERENCE = 0.01  # of a parameter's start: the step of the difference quotients


class Variable(NamedTuple):
    effect: str
    where: str
    parameter: str
    low: float
    high: float
    scale: float
    prior: float  # standard deviation, inf without one


def variables_of(log: Evidence, effects: Sequence[Placed], nominal: Sequence[Nominal]) -> list[Variable]:
    """The effects' parameters, then the nominal numbers, in their order."""
    known = {effect.name: effect for effect in log.atoms.effects}
    found = [
        Variable(p.effect, p.where, q.name, q.low, q.high, abs(q.start) or abs(q.high), np.inf)
        for p in effects
        for q in known[p.effect].parameters
    ]
    for n, low, high in zip(nominal, *reach(log.atoms.effects, nominal), strict=True):
        prior = n.deviation
        if any(stands_for(known[p.effect], p.where, p.parameters, n, log.atoms.joint_names) for p in effects):
            low, high, prior = 0.0, 0.0, PINNED * n.deviation
        found.append(Variable(n.effect, n.where, n.parameter, low, high, n.deviation, prior))
    return found


def stands_for(
    effect: Effect, where: str, parameters: Collection[str], n: Nominal, joint_names: tuple[str, ...]
) -> bool:
    """Whether an effect changes a nominal number wherever that counts: free beside it, neither would be determined."""
    if effect.name != n.effect or n.parameter not in parameters:
        return False
    return bool((mask(where, effect.axis, joint_names) >= mask(n.where, effect.axis, joint_names)).all())


def reach(effects: Sequence[Effect], nominal: Sequence[Nominal]) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest value of each nominal number, in its own unit: FARTHEST, or its parameter's own bound."""
    known = {(effect.name, p.name): p for effect in effects for p in effect.parameters}
    bounds = [known[n.effect, n.parameter] for n in nominal]
    low = [max(p.low, -FARTHEST * n.deviation) for p, n in zip(bounds, nominal, strict=True)]
    high = [min(p.high, FARTHEST * n.deviation) for p, n in zip(bounds, nominal, strict=True)]
    return np.array(low), np.array(high)


def first_value(effects: Sequence[Placed], x: Variable) -> float:
    """What an effect's parameter starts from, within its bounds."""
    placed = next(p for p in effects if (p.effect, p.where) == (x.effect, x.where))
    return float(np.clip(placed.parameters[x.parameter], x.low, x.high))


def added(atoms: Atoms, x: np.ndarray, variable: Variable, value: float) -> np.ndarray:
    """Strengths at a place add up; a shape parameter is what the last one says."""
    here = atoms.selection(variable.effect, variable.where)
    k = [c.parameter.name for c in atoms.of(variable.effect)].index(variable.parameter)
    chosen = here[:, k] > 0
    x = x.copy()
    strength = atoms.of(variable.effect)[k].parameter.role == "strength"
    x[chosen] = x[chosen] + value if strength else value
    return x


def direction(variable: Variable, value: float) -> float:
    """Sign of the difference quotient's step: away from the upper bound."""
    return -1.0 if value + DIFFERENCE * variable.scale > variable.high else 1.0


def difference(atoms: Atoms, variable: Variable, value: float) -> np.ndarray:
    """The difference quotient's step in x."""
    here = atoms.selection(variable.effect, variable.where)
    k = [c.parameter.name for c in atoms.of(variable.effect)].index(variable.parameter)
    return here[:, k] * DIFFERENCE * variable.scale * direction(variable, value)
