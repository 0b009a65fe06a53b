"""The closed loop: a real jump, the same bits on any number of devices, failures as data, engines that agree."""

import jax
import numpy as np
import pytest

from experiments.batch import device_mesh
from experiments.effects import LIBRARY
from experiments.evaluation import Evaluation, crossed
from experiments.model import nominal_model
from experiments.perturbations import load_perturbations, nominal_columns
from experiments.tasks.definition import load_task

# A jump of an earlier search with the full drive train: what matters here is that it flies, lands and stands.
JUMP = [0.227, 0.273, 0.436, 0.541, 0.291, 0.428, 0.259, 0.251, 0.252, 0.441, 0.47, 0.389, 389.0]
CHUNK = 2


@pytest.fixture(scope="module")
def candidates() -> np.ndarray:
    initial = load_task("squat_jump").space().initial
    broken = initial.copy()
    broken[12] = 1e9  # a damping gain that no loop survives
    return np.stack([initial, np.array(JUMP, np.float32), broken, initial + np.float32(0.001)])


@pytest.fixture(scope="module")
def scores(candidates):
    """The same candidates on one and on two devices, in chunks of the same size."""
    model, definition = nominal_model(), load_task("squat_jump")
    perturbations = load_perturbations(None, model)
    nominal = {n: np.full(1, v, np.float32) for n, v in nominal_columns(perturbations.names, model).items()}
    members = crossed(candidates, nominal, np.zeros(1, np.int32))

    def on(devices: int):
        mesh = device_mesh(jax.devices()[:devices])
        return Evaluation(model, definition, "full", LIBRARY, mesh, CHUNK).scores(members)

    return on(1), on(2)


def test_one_and_two_devices_agree_to_the_bit(scores) -> None:
    one, two = scores
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_jump_flies_lands_and_stands(scores) -> None:
    metrics = scores[0].metrics
    assert 0.65 < metrics["apex_height"][1] < 0.85
    assert metrics["landed"][1] == 1.0 and metrics["success"][1] == 1.0
    assert metrics["apex_height"][0] < metrics["apex_height"][1] - 0.1, "the initial guess must be clearly lower"


def test_cost_is_the_sum_of_its_terms(scores) -> None:
    total = sum(np.asarray(term, float) for term in scores[0].terms.values())
    np.testing.assert_allclose(scores[0].cost, total, rtol=1e-4)


def test_a_broken_candidate_has_a_finite_cost_and_does_not_spread(scores) -> None:
    assert np.isfinite(scores[0].cost).all()
    assert scores[0].cost[2] > scores[0].cost[0]


def test_trials_do_not_depend_on_how_many_there_are() -> None:
    perturbations = load_perturbations(None, nominal_model())
    few, start_few = perturbations.columns(jax.random.key(3), 5)
    many, start_many = perturbations.columns(jax.random.key(3), 50)
    for name in few:
        np.testing.assert_array_equal(few[name], many[name][:5])
    np.testing.assert_array_equal(start_few, start_many[:5])
