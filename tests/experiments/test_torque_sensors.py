"""A controller that knows how its torque sensors err asks for the reading of the torque that it wants."""

import jax.numpy as jnp
import numpy as np
import pytest

from controller_jax.types import JointTargets
from experiments.model import FittedValue, Model, PlacedEffect, nominal_model
from experiments.plant import make_plant
from experiments.tasks.definition import load_task
from experiments.tasks.registry import make_task
from experiments.torque_sensors import as_read, known_torque_sensors
from mjx_starleth.names import JOINT_NAMES

WANTED = np.linspace(-20.0, 20.0, 12).astype(np.float32)


def learned(model: Model, effect: str, where: str, name: str, value: float) -> Model:
    return model.with_effect(PlacedEffect(effect=effect, where=where, parameters={name: FittedValue(value=value)}))


def misled() -> Model:
    """Sensors that show 15 % too much, and in the knees 2 N m more."""
    model = learned(nominal_model(), "torque_sensor_gain", "all", "relative", 0.15)
    return learned(model, "torque_sensor_offset", "KFE", "offset", 2.0)


def test_it_asks_for_what_the_sensors_show_of_the_wanted_torques() -> None:
    still = jnp.zeros(12)
    asked = as_read(known_torque_sensors(misled()), JointTargets(jnp.asarray(WANTED), still, still))
    shown = 1.15 * WANTED + 2.0 * np.array([name.endswith("KFE") for name in JOINT_NAMES])
    np.testing.assert_allclose(asked.torque, shown, rtol=1e-6)
    assert not np.any(asked.position) and not np.any(asked.position_mode)


def test_the_plants_sensors_show_what_was_asked_for_at_the_wanted_torques() -> None:
    plant, still = make_plant(misled()), jnp.zeros(12)
    params = plant.prepare(plant.params)
    aloft = jnp.concatenate([jnp.asarray([0.0, 0.0, 0.6, 1.0, 0.0, 0.0, 0.0]), jnp.zeros(12)])
    _, shown = plant.measure(params, plant.initial_state(params, aloft, jnp.asarray(WANTED)))
    asked = as_read(known_torque_sensors(misled()), JointTargets(jnp.asarray(WANTED), still, still))
    np.testing.assert_allclose(asked.torque, shown.torque, rtol=1e-6)


@pytest.mark.parametrize("name", ["squat_jump", "pronk"])
def test_only_a_model_that_has_learned_of_them_changes_a_task(name: str) -> None:
    heavy = learned(nominal_model(), "payload", "torso", "mass", 2.0)
    assert make_task(load_task(name), heavy).torque_sensors is None
    assert make_task(load_task(name), misled()).torque_sensors is not None
