"""Risk measures against their definitions."""

import jax.numpy as jnp
import numpy as np
import pytest

from es import Risk, reduce_costs

# float32 sums of up to 40 costs of size 10
TOLERANCE = 2e-5


def cvar_by_definition(costs: np.ndarray, alpha: float) -> float:
    """min over t of t + E[max(c - t, 0)] / (1 - alpha) (Rockafellar and Uryasev 2000); the minimum is at a cost."""
    return min(t + np.mean(np.maximum(costs - t, 0.0)) / (1.0 - alpha) for t in costs)


@pytest.mark.parametrize("trials", [1, 3, 10, 40])
@pytest.mark.parametrize("alpha", [0.0, 0.25, 0.5, 0.9, 0.95, 0.999])
def test_cvar_is_what_its_definition_says(trials, alpha):
    costs = np.random.default_rng(trials).normal(0.0, 10.0, (20, trials))
    costs[0] = 3.0  # ties
    expected = [cvar_by_definition(row, alpha) for row in costs]
    found = reduce_costs(jnp.asarray(costs, jnp.float32), Risk("cvar", alpha))
    np.testing.assert_allclose(found, expected, rtol=TOLERANCE, atol=10 * TOLERANCE)


def test_mean_and_worst():
    costs = jnp.array([[1.0, 2.0, 6.0], [-1.0, -5.0, 0.0]])
    np.testing.assert_allclose(reduce_costs(costs, Risk("mean")), [3.0, -2.0], rtol=TOLERANCE)
    np.testing.assert_array_equal(reduce_costs(costs, Risk("worst")), [6.0, 0.0])


@pytest.mark.parametrize("risk", [Risk("mean"), Risk("worst"), Risk("cvar", 0.5)])
@pytest.mark.parametrize("failure", [np.nan, np.inf, -np.inf])
def test_one_failed_trial_fails_its_candidate_and_no_other(risk, failure):
    costs = jnp.array([[1.0, failure, 2.0, 3.0], [1.0, 2.0, 3.0, 4.0]])
    assert np.isfinite(reduce_costs(costs, risk)).tolist() == [False, True]


def test_nonsense_is_refused():
    with pytest.raises(ValueError, match="unknown risk measure 'median'"):
        Risk("median")
    with pytest.raises(ValueError, match="below 1"):
        Risk("cvar", 1.0)
    with pytest.raises(ValueError, match="takes no alpha"):
        Risk("worst", 0.5)
