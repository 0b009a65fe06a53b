"""Replay on other engines: what acts on Moreau's bodies acts on theirs, and a diverging run is a failed one."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.errors import UserError
from experiments.imu_sensing import make_sensing
from experiments.model import FittedValue, PlacedEffect, nominal_model
from experiments.plant import make_plant
from experiments.recording import until_divergence
from experiments.rollout import Rollout, Tick
from experiments.stepping import run_with_engine
from experiments.tasks.definition import load_task
from experiments.tasks.registry import make_task
from experiments.trial import Trial, noise_table

TICKS = 60  # of the crouch
PUSH = 40.0  # N
TOLERANCE = 0.01  # m/s and rad/s of the torso: the engines' contacts differ
EFFECTS = (("constant_force", "torso", {"x": 60.0}), ("joint_viscous_drag", "all", {"coefficient": 5.0}))


def hindered() -> Rollout:
    """The crouch of a robot that is pulled forward and whose joints are dragged."""
    model = nominal_model()
    for name, where, given in EFFECTS:
        values = {p.name: FittedValue(value=given.get(p.name, p.off)) for p in LIBRARY[name].parameters}
        model = model.with_effect(PlacedEffect(effect=name, where=where, parameters=values))
    task = replace(make_task(load_task("squat_jump"), model), ticks=TICKS)
    return Rollout(make_plant(model, "ideal"), task, make_sensing("direct", model))


@pytest.fixture(scope="module")
def loop():
    rollout = hindered()
    values = jnp.asarray(load_task("squat_jump").space().initial, jnp.float32)
    return rollout, (rollout.plant.params, rollout.task.settings, values)


def trial(push: float) -> Trial:
    numbers = {"push_x": push, "push_start": 0.0, "push_duration": 1.0}
    return Trial({name: jnp.float32(x) for name, x in numbers.items()}, noise_table(), jnp.zeros((), jnp.int32))


def test_effects_on_bodies_and_pushes_act_in_mujoco_c(loop) -> None:
    rollout, (params, *start) = loop
    record = jax.jit(rollout.record)

    def by_moreau(effects, push: float) -> np.ndarray:
        ticks = record(params._replace(effects=effects), *start, trial(push))[1]
        return np.asarray(ticks.after.bodies.u[-1, :6])

    (force, drag), off = params.effects, jax.tree.map(jnp.zeros_like, params.effects)
    expected = by_moreau(params.effects, PUSH)
    for lacking in ((off[0], drag), (force, off[1])):
        assert abs(by_moreau(lacking, PUSH)[0] - expected[0]) > 5 * TOLERANCE
    assert abs(by_moreau(params.effects, 0.0)[0] - expected[0]) > 5 * TOLERANCE
    found = run_with_engine("mujoco_c", rollout, params, *start, trial(PUSH))[1].after.bodies.u[-1, :6]
    np.testing.assert_allclose(found, expected, atol=TOLERANCE)


def test_a_run_that_diverges_in_mujoco_c_has_failed(loop) -> None:
    rollout, start = loop
    score, ticks = run_with_engine("mujoco_c", rollout, *start, trial(1e13))
    assert score.terms["fall"] == rollout.task.weights["fall"]
    assert not score.metrics["landed"] and not score.metrics["success"]
    assert np.isfinite(score.cost) and not ticks.alive.any()


def test_a_diverging_motion_is_shown_up_to_there() -> None:
    ticks = Tick(*(np.arange(5.0) for _ in Tick._fields))._replace(alive=np.array([1, 1, 1, 0, 0]))
    np.testing.assert_array_equal(until_divergence(ticks).time, [0, 1, 2])
    with pytest.raises(UserError, match="diverges from the first moment on"):
        until_divergence(ticks._replace(alive=np.array([1, 0, 0, 0, 0])))
