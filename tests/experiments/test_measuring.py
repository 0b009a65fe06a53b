"""From a log to a better model, on short logs: no effect is found where none is, a planted one is."""

from pathlib import Path

import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.measurement.compare import compare, whiteness
from experiments.measurement.learn import learn, parse_place
from experiments.measurement.log_reader import read_log
from experiments.measurement.noise_floor import estimated
from experiments.model import FittedValue, PlacedEffect, load_model, nominal_model, save_model

DATA = Path(__file__).parents[1] / "data"
SAME_AS_NOISE = 1.45  # residual over noise of a right model: the worst of 36 channels on 600 rows


@pytest.fixture(scope="module")
def log():
    return read_log(DATA / "squat_reference_1500ms.csv.gz")


def wrong_model():
    """The nominal robot and a gear friction that it does not have: for it, the reference lacks friction."""
    extra = PlacedEffect(effect="coulomb_friction", where="all", parameters={"torque": FittedValue(value=0.006)})
    return nominal_model().with_effect(extra)


def test_the_right_model_explains_the_log_down_to_the_noise(log) -> None:
    found = compare(log, nominal_model(), {"coulomb_friction": LIBRARY["coulomb_friction"]})
    drive = found.misfit.drive
    assert drive.max() < SAME_AS_NOISE, drive


def test_a_wrong_model_fails_where_it_is_wrong_and_learning_mends_it(log, tmp_path) -> None:
    library = {"coulomb_friction": LIBRARY["coulomb_friction"]}
    assert compare(log, wrong_model(), library).worst.over_noise > 2.0
    learned, _, _ = learn([log], nominal_model(), library, [("coulomb_friction", "all")])
    fitted = learned.effects[0].parameters["torque"]
    low, high = fitted.ci95
    assert low < 0.0 < high or abs(fitted.value) < 1e-4, "the reference has no more friction than nominal"
    save_model(tmp_path / "model.json", learned)
    assert load_model(tmp_path / "model.json").hash() == learned.hash()


def test_places_are_parsed() -> None:
    names = nominal_model().joint_names
    assert parse_place("backlash@LH_KFE", LIBRARY, names) == ("backlash", "LH_KFE")
    assert parse_place("payload", LIBRARY, names) == ("payload", "torso")


def test_whiteness_and_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(0)
    noise = 0.3 * rng.standard_normal((4000, 3))
    assert 0.5 < whiteness(noise[:, 0]) < 2.0
    assert whiteness(np.cumsum(noise[:, 0])) > 20.0
    moving = noise + np.sin(np.linspace(0, 60, 4000))[:, None]
    assert abs(estimated(moving) / 0.3 - 1) < 0.1
