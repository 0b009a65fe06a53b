"""How far a robot's nominal numbers may be off before one of them counts as an effect."""

import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.measurement.evidence.features import changes_of
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fits.fit_variables import FARTHEST
from experiments.measurement.fits.nominal import (
    all_inexact,
    as_far_as_others,
    at_end,
    never_given,
    nominal_freedom,
    numbers_among,
)
from experiments.model import nominal_model

NUMBERS = nominal_freedom(nominal_model(), tuple(LIBRARY.values()), standing=False)


def fit(off: np.ndarray, known: float | np.ndarray = 0.05) -> Refitted:
    """A fit with numbers off by these deviations and each known to a share of its own."""
    deviation = np.array([n.deviation for n in NUMBERS])
    return Refitted((), off * deviation, known * deviation, (), (), np.zeros((0, 0)))


def farthest(numbers: tuple[Nominal, ...]) -> float:
    """How far they may be off, over how far they might before."""
    return numbers[0].deviation / NUMBERS[0].deviation


@pytest.mark.parametrize("seed", range(5))
def test_a_robot_whose_numbers_are_all_within_three_percent_has_none_ten_percent_off(seed) -> None:
    off = 0.5 * np.random.default_rng(seed).uniform(-1.0, 1.0, len(NUMBERS))
    place = next(i for i, n in enumerate(NUMBERS) if (n.effect, n.where) == ("torque_constant", "KFE"))
    off[place] = -1.7  # the effect, as the number that takes it in
    free = as_far_as_others(NUMBERS, fit(off))
    assert 0.5 / FARTHEST < farthest(free) < 1.2 / FARTHEST
    clipped = np.clip(off, -FARTHEST * farthest(free), FARTHEST * farthest(free))
    assert [(n.effect, n.where) for n in at_end(free, fit(clipped))] == [("torque_constant", "KFE")]


def test_a_robot_that_is_off_everywhere_keeps_its_freedom() -> None:
    off = np.linspace(-1.7, 1.7, len(NUMBERS))
    assert as_far_as_others(NUMBERS, fit(off)) == NUMBERS
    assert at_end(NUMBERS, fit(off)) == ()


def test_numbers_that_the_log_cannot_tell_tell_nothing_of_the_others() -> None:
    off = np.full(len(NUMBERS), 0.1)
    assert as_far_as_others(NUMBERS, fit(off, known=0.5)) == NUMBERS
    assert farthest(as_far_as_others(NUMBERS, fit(off, known=0.2))) < 0.5


def test_few_numbers_that_the_log_can_tell_tell_nothing_of_the_others() -> None:
    told = {"torque_constant", "motor_inertia"}  # one of them may be the effect
    known = np.array([0.05 if n.effect in told else 0.9 for n in NUMBERS])
    assert as_far_as_others(NUMBERS, fit(np.full(len(NUMBERS), 0.1), known)) == NUMBERS


def test_the_friction_of_loaded_bearings_is_no_models_and_every_robots() -> None:
    effects = tuple(LIBRARY.values())
    (bearings,) = never_given(nominal_model(), effects)
    assert (bearings.effect, bearings.where) == ("bearing_friction", "all") and bearings.deviation > 0


def test_a_bearing_may_rub_as_much_as_it_does_however_near_the_other_numbers_are() -> None:
    off = np.array([1.0 if n.effect == "bearing_friction" else 0.1 for n in NUMBERS])
    narrowed = as_far_as_others(NUMBERS, fit(off))
    assert [n for n in narrowed if n.effect == "bearing_friction"] == [
        n for n in NUMBERS if n.effect == "bearing_friction"
    ]
    assert farthest(narrowed) < 0.5
    wider = np.where([n.effect == "torque_constant" for n in NUMBERS], 1.0, off)  # an effect, taken in
    assert as_far_as_others(NUMBERS, fit(wider)) == narrowed


def test_a_nominal_number_is_what_the_first_change_of_its_effect_changes() -> None:
    """The linear score projects out a heavier torso, not a load on one side of it."""
    changes, variants = changes_of(tuple(LIBRARY.values()))
    payload = [change for change in changes if change.effect.name == "payload"]
    assert len(payload) == 9 and all(value == 0.0 for _, value in payload[0].shapes)
    assert sum(variant.effect.name == "payload" for variant in variants) == 9


def test_an_effect_may_be_a_number_if_it_is_as_small_at_a_place_where_such_numbers_are_given() -> None:
    inertia = Placed("motor_inertia", "HFE", {"relative": -0.0095})
    others = (
        inertia._replace(parameters={"relative": -0.13}),  # more than a data sheet may be off by
        inertia._replace(where="LF_HFE"),  # one joint alone is not built otherwise
        Placed("ground_slope", "feet", {"x": 0.01, "y": 0.0}),
        Placed("payload", "torso", {"mass": 0.5, "x": 0.1, "y": 0.0, "z": 0.0}),  # a number is a mass at the centre
    )
    assert numbers_among((inertia, *others), NUMBERS) == (inertia,)


@pytest.mark.parametrize("where", ["all", "HFE", "LF_HFE"])
def test_no_data_sheet_is_exact_to_a_per_cent(where: str) -> None:
    soft = Placed("spring_stiffness", where, {"relative": -0.008})
    others = (
        soft._replace(parameters={"relative": -0.012}),
        Placed("torque_sensor_gain", where, {"relative": 0.001}),  # of no number
        Placed("payload", "torso", {"mass": 0.001, "x": 0.1, "y": 0.0, "z": 0.0}),
    )
    assert all_inexact((soft,), NUMBERS) and not all_inexact((), NUMBERS)
    assert not any(all_inexact((soft, other), NUMBERS) for other in others)
