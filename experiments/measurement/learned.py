"""What a fit found, as effects of a model file.

A fit adds strengths to what the model has at a place already; in a file the last effect at a place rules. So each place
is written with all that acts there, the widest places first.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from experiments.effects.places import mask
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.fits.fit_types import Nominal, Refitted
from experiments.measurement.selection.belief import COVERAGE, interval
from experiments.model import FittedValue, Model, PlacedEffect

WORTH = 0.2  # of its prior's deviation, that a nominal number has to be off by to be written
SAME = 1e-9  # of a number: less is rounding


def with_learned(model: Model, atoms: Atoms, fit: Refitted, numbers: Sequence[Nominal]) -> Model:
    """The model with a fit's effects and nominal numbers; `numbers` are the first of those that the fit moved."""
    found = [*_effects(atoms, fit), *_numbers(atoms, fit, numbers)]
    x = atoms.placed(atoms.off(), model.effects)
    for placed in found:
        x = _moved(atoms, x, placed)
    names = {placed.effect for placed in found}
    effects = [e for e in model.effects if e.effect not in names]
    for name in sorted(names, key=[placed.effect for placed in found].index):
        places = _places([e for e in (*model.effects, *found) if e.effect == name])
        effects += _written(atoms, x, sorted(places, key=lambda e: -_where(atoms, e).sum()))
    return model.model_copy(update={"effects": tuple(effects)})


def _effects(atoms: Atoms, fit: Refitted) -> Iterator[PlacedEffect]:
    """The fitted effects, alone, with intervals."""
    k = 0
    for placed in fit.effects:
        units = _units(atoms, placed.effect)
        values = {}
        for name, value in placed.parameters.items():
            values[name] = FittedValue(value=value, ci95=interval(fit, k, value), unit=units[name])
            k += 1
        yield PlacedEffect(effect=placed.effect, where=placed.where, parameters=values)


def _numbers(atoms: Atoms, fit: Refitted, numbers: Sequence[Nominal]) -> Iterator[PlacedEffect]:
    """The nominal numbers that turned out to be off, as effects."""
    for n, value, spread in zip(numbers, fit.nominal, fit.spread, strict=False):
        if abs(value) > WORTH * n.deviation:
            half, unit = COVERAGE * float(spread), _units(atoms, n.effect)[n.parameter]
            fitted = FittedValue(value=float(value), ci95=(value - half, value + half), unit=unit)
            yield PlacedEffect(effect=n.effect, where=n.where, parameters={n.parameter: fitted})


def _moved(atoms: Atoms, x: np.ndarray, placed: PlacedEffect) -> np.ndarray:
    """x (n,) with an effect's strengths added and its shapes set, as a fit does."""
    x, here = x.copy(), _where(atoms, placed)
    for c in atoms.of(placed.effect):
        if c.parameter.name in placed.parameters:
            value = placed.parameters[c.parameter.name].value
            part = x[c.start : c.start + c.size]
            part[here] = part[here] + value if c.parameter.role == "strength" else value
    return x


def _places(effects: Sequence[PlacedEffect]) -> list[PlacedEffect]:
    """One entry for each place; parameters that stand at one twice have the last one's interval."""
    found: dict[str, PlacedEffect] = {}
    for e in effects:
        before = found[e.where].parameters if e.where in found else {}
        found[e.where] = e.model_copy(update={"parameters": {**before, **e.parameters}})
    return list(found.values())


def _written(atoms: Atoms, x: np.ndarray, places: Sequence[PlacedEffect]) -> Iterator[PlacedEffect]:
    """One effect's entries, widest place first, so that each of its atoms ends at its value in x.

    Where places cross, what a place has is not one number: there each joint is written.
    """
    for k, placed in enumerate(places):
        later = [_where(atoms, e) for e in places[k + 1 :]]
        ruled = np.flatnonzero(_where(atoms, placed) & ~np.any([*later, np.zeros(_size(atoms, placed), bool)], 0))
        if len(ruled) == 0:
            continue
        each = [_at(atoms, x, placed, i) for i in ruled]
        if all(one.values() == each[0].values() for one in each):
            yield each[0]
        else:
            names = atoms.joint_names
            yield from (one.model_copy(update={"where": names[i]}) for i, one in zip(ruled, each, strict=True))


def _at(atoms: Atoms, x: np.ndarray, placed: PlacedEffect, i: int) -> PlacedEffect:
    """An entry with what x has at the i-th joint, link or foot; intervals keep their width."""
    values = {}
    for c in atoms.of(placed.effect):
        fitted = placed.parameters.get(c.parameter.name)
        if fitted is not None:
            now = float(x[c.start + i])
            now = fitted.value if abs(now - fitted.value) <= SAME * abs(now) else now
            by = now - fitted.value
            ci95 = fitted.ci95 and (fitted.ci95[0] + by, fitted.ci95[1] + by)
            values[c.parameter.name] = fitted.model_copy(update={"value": now, "ci95": ci95})
    return placed.model_copy(update={"parameters": values})


def _where(atoms: Atoms, placed: PlacedEffect) -> np.ndarray:
    """(size,) where an effect acts."""
    return mask(placed.where, atoms.of(placed.effect)[0].effect.axis, atoms.joint_names) > 0


def _size(atoms: Atoms, placed: PlacedEffect) -> int:
    return atoms.of(placed.effect)[0].size


def _units(atoms: Atoms, effect: str) -> dict[str, str]:
    return {c.parameter.name: c.parameter.unit for c in atoms.of(effect)}
