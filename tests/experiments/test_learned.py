"""What a fit found is written so that the file's model is the fitted one, whatever the model had there before."""

import numpy as np
import pytest

from experiments.effects.library import LIBRARY
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.learned import with_learned
from experiments.model import FittedValue, Model, PlacedEffect, nominal_model
from mjx_starleth.names import JOINT_NAMES

NAMES = ("coulomb_friction", "stribeck_friction", "payload", "backlash")
ATOMS = Atoms(tuple(LIBRARY[name] for name in NAMES), JOINT_NAMES)


def placed(effect: str, where: str, **values: float) -> PlacedEffect:
    parameters = {name: FittedValue(value=value, ci95=(value - 1.0, value + 1.0)) for name, value in values.items()}
    return PlacedEffect(effect=effect, where=where, parameters=parameters)


def learned(kept: list[PlacedEffect], effects=(), numbers=(), nominal=()) -> tuple[Model, np.ndarray]:
    """The written model, and the atoms that it stands for."""
    model = nominal_model().model_copy(update={"effects": tuple(kept)})
    count = sum(len(e.parameters) for e in effects)
    spread, covariance = np.full(len(nominal), 1e-4), 1e-8 * np.eye(count)
    fit = Refitted(tuple(effects), np.array(nominal, float), spread, (), (), covariance)
    found = with_learned(model, ATOMS, fit, numbers)
    return found, ATOMS.placed(ATOMS.off(), found.effects)


def torque(x: np.ndarray, joint: str) -> float:
    return x[ATOMS.of("coulomb_friction")[0].start + JOINT_NAMES.index(joint)]


def test_a_strength_adds_to_what_a_wider_place_has_already() -> None:
    kept = [placed("coulomb_friction", "all", torque=0.004), placed("backlash", "LH_KFE", half_width=0.02)]
    found, x = learned(kept, [Placed("coulomb_friction", "KFE", {"torque": 0.002})])
    assert torque(x, "LF_KFE") == pytest.approx(0.006) and torque(x, "LF_HAA") == 0.004
    assert found.effects[0] == kept[1]
    low, high = found.effects[-1].parameters["torque"].ci95
    assert low < 0.006 < high and high - low < 0.001


def test_a_wider_place_adds_to_what_a_narrow_one_has_already() -> None:
    kept = [placed("coulomb_friction", "LH_KFE", torque=0.004)]
    found, x = learned(kept, [Placed("coulomb_friction", "all", {"torque": 0.002})])
    assert torque(x, "LH_KFE") == pytest.approx(0.006) and torque(x, "RH_KFE") == 0.002
    assert [e.where for e in found.effects] == ["all", "LH_KFE"]


def test_places_that_cross_are_written_joint_by_joint() -> None:
    kept = [placed("coulomb_friction", "LH", torque=0.004)]
    _, x = learned(kept, [Placed("coulomb_friction", "KFE", {"torque": 0.002})])
    there = [torque(x, name) for name in ("LH_KFE", "LH_HAA", "RF_KFE", "RF_HAA")]
    assert there == pytest.approx([0.006, 0.004, 0.002, 0.0])


def test_a_nominal_number_beside_an_effect_keeps_the_effect_s_other_parameters() -> None:
    kept = [placed("payload", "torso", mass=2.5, x=0.1, y=0.02, z=0.05)]
    found, _ = learned(kept, (), [Nominal("payload", "torso", "mass", 0.9)], [0.3])
    (load,) = found.effects
    assert load.values() == pytest.approx({"mass": 2.8, "x": 0.1, "y": 0.02, "z": 0.05})
    assert load.parameters["mass"].unit == "kg" and load.parameters["mass"].ci95 is not None


def test_a_nominal_number_of_a_kind_adds_to_the_effect_of_one_joint() -> None:
    numbers = [Nominal("coulomb_friction", "KFE", "torque", 2e-4), Nominal("coulomb_friction", "HAA", "torque", 2e-4)]
    found, x = learned([], [Placed("coulomb_friction", "LH_KFE", {"torque": 0.002})], numbers, [3e-4, 1e-6])
    assert torque(x, "LH_KFE") == pytest.approx(0.0023) and torque(x, "LF_KFE") == pytest.approx(3e-4)
    assert torque(x, "LF_HAA") == 0.0 and [e.where for e in found.effects] == ["KFE", "LH_KFE"]


def test_a_shape_is_what_was_fitted_last() -> None:
    kept = [placed("stribeck_friction", "all", torque=0.004, velocity=0.1)]
    found, _ = learned(kept, [Placed("stribeck_friction", "KFE", {"torque": 0.002, "velocity": 0.3})])
    assert found.effects[-1].values() == pytest.approx({"torque": 0.006, "velocity": 0.3})
