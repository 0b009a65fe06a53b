"""The closed loop: a real jump, failures as data."""

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
    broken[3] = np.nan  # diverges in the middle of the launch
    return np.stack([initial, np.array(JUMP, np.float32), broken, initial + np.float32(0.001)])


@pytest.fixture(scope="module")
def judge():
    """Scores of candidates (4, n) in undisturbed trials."""
    model, definition = nominal_model(), load_task("squat_jump")
    perturbations = load_perturbations(None, model)
    nominal = {n: np.full(1, v, np.float32) for n, v in nominal_columns(perturbations.names, model).items()}
    evaluation = Evaluation(model, definition, "full", LIBRARY, device_mesh(jax.devices()[:1]), CHUNK)
    return lambda candidates: evaluation.scores(crossed(candidates, nominal, np.zeros(1, np.int32)))


@pytest.fixture(scope="module")
def scores(judge, candidates):
    return judge(candidates)


def test_the_jump_flies_lands_and_stands(scores) -> None:
    metrics = scores.metrics
    assert 0.65 < metrics["apex_height"][1] < 0.85
    assert metrics["landed"][1] == 1.0 and metrics["success"][1] == 1.0
    assert metrics["apex_height"][0] < metrics["apex_height"][1] - 0.1, "the initial guess must be clearly lower"


def test_cost_is_the_sum_of_its_terms(scores) -> None:
    total = sum(np.asarray(term, float) for term in scores.terms.values())
    np.testing.assert_allclose(scores.cost, total, rtol=1e-4)


def test_a_broken_candidate_has_a_finite_cost_and_does_not_spread(judge, candidates, scores) -> None:
    assert np.isfinite(scores.cost).all()
    assert scores.terms["fall"][2] == load_task("squat_jump").weights["fall"] and not scores.terms["fall"][:2].any()
    assert not scores.metrics["landed"][2] and not scores.metrics["success"][2]
    mended = judge(candidates[[0, 1, 0, 3]])
    kept = [0, 1, 3]  # the last is in the broken one's chunk
    for found, expected in zip(jax.tree.leaves(scores), jax.tree.leaves(mended), strict=True):
        np.testing.assert_array_equal(found[kept], expected[kept])
