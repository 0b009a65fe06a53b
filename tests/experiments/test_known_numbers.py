"""A controller knows the masses that its model has learned, and nothing else of it."""

import numpy as np
import pytest

from controller_jax.geometry import geometry_from_numbers
from experiments.known_numbers import known_numbers
from experiments.model import FittedValue, Model, PlacedEffect, nominal_model
from experiments.tasks.definition import load_task
from experiments.tasks.registry import make_task


def learned(effect: str, where: str, **values: float) -> Model:
    parameters = {name: FittedValue(value=value) for name, value in values.items()}
    return nominal_model().with_effect(PlacedEffect(effect=effect, where=where, parameters=parameters))


def test_a_load_moves_the_torsos_mass_and_centre() -> None:
    torso = nominal_model().numbers.bodies.torso
    geometry = geometry_from_numbers(known_numbers(learned("payload", "torso", mass=3.0, x=0.15, y=-0.02, z=0.1)))
    total = torso.mass + 3.0
    assert float(geometry.torso_mass) == pytest.approx(total)
    centre = (torso.mass * np.array(torso.com) + 3.0 * np.array([0.15, -0.02, 0.1])) / total
    np.testing.assert_allclose(geometry.torso_com_B, centre, atol=1e-7)


def test_heavy_links_count_by_the_mean_of_the_legs() -> None:
    bodies = nominal_model().numbers.bodies
    geometry = geometry_from_numbers(known_numbers(learned("link_mass", "LH_KFE", relative=0.4)))
    wanted = [bodies.hip.mass, bodies.thigh.mass, 1.1 * bodies.shank.mass]
    np.testing.assert_allclose(geometry.link_mass, wanted, rtol=1e-6)


def test_what_is_no_mass_stays_unknown_to_the_controller() -> None:
    nominal = nominal_model()
    assert known_numbers(learned("backlash", "all", half_width=0.02)) == nominal.numbers.model_dump(mode="json")


@pytest.mark.parametrize("name", ["squat_jump", "pronk"])
def test_the_tasks_controllers_are_made_of_it(name: str) -> None:
    task = make_task(load_task(name), learned("payload", "torso", mass=3.0, x=0.0, y=0.0, z=0.1))
    nominal = make_task(load_task(name), nominal_model())
    added = task.settings.geometry.torso_mass - nominal.settings.geometry.torso_mass
    assert float(added) == pytest.approx(3.0, abs=1e-4)
