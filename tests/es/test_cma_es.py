"""The parts of CMA-ES that replace evosax's, and its behaviour on costs that are not numbers."""

import jax
import numpy as np
import pytest
from es_problems import POPULATION, SETTINGS, SIZE, distance_squared, space

import es
from es import cma_es


def anisotropic_state(seed: int = 0):
    """An engine and a state with a random covariance, and that covariance."""
    engine = cma_es.make_engine(POPULATION, SIZE)
    root = np.random.default_rng(seed).standard_normal((SIZE, SIZE))
    covariance = (root @ root.T / SIZE + 0.1 * np.eye(SIZE)).astype(np.float32)
    state = cma_es.start(engine, np.arange(SIZE, dtype=np.float32), 0.5)
    return engine, cma_es.on_search_device(state.replace(C=covariance)), covariance


def draw(engine, state, seed: int = 0):
    with cma_es.library_numerics():
        told, state = engine.ask(jax.random.key(seed), state, engine.params)
    return np.asarray(told), state


def test_samples_have_the_mean_and_covariance_of_the_state():
    engine, state, covariance = anisotropic_state()
    _, state = draw(engine, state)
    with cma_es.library_numerics():
        samples = jax.vmap(lambda seed: engine.draw(jax.random.key(seed), state))(np.arange(1500))
    samples = np.asarray(samples).reshape(-1, SIZE)
    # 18 000 samples: standard errors are 0.004 of the largest deviation and 1 % of the covariance; 5 of them
    np.testing.assert_allclose(samples.mean(axis=0), np.arange(SIZE), atol=5 * 0.004)
    np.testing.assert_allclose(np.cov(samples.T), 0.25 * covariance, atol=5 * 0.01 * 0.25 * covariance.max())


def test_samples_depend_continuously_on_the_covariance():
    """Nearly equal eigenvalues: a change of 1e-5 turns the eigenvectors entirely, and must not turn the samples."""
    engine, state, _ = anisotropic_state()
    rng = np.random.default_rng(1)
    change = rng.standard_normal((SIZE, SIZE)) * 1e-5
    one, other = np.eye(SIZE, dtype=np.float32), (np.eye(SIZE) + change + change.T).astype(np.float32)
    first, first_state = draw(engine, state.replace(C=one))
    second, second_state = draw(engine, state.replace(C=other))
    assert np.max(np.abs(np.asarray(first_state.B - second_state.B))) > 0.1  # the eigenbasis did turn
    assert np.max(np.abs(first - second)) < 1e-3  # 4 sigma times n times the change, and a margin of 10


def weights(costs, seed: int = 0):
    engine, state, _ = anisotropic_state()
    told, state = draw(engine, state, seed)
    with cma_es.library_numerics():
        found = engine.fitness_shaping_fn(told, np.asarray(costs, np.float32), state, engine.params)
    return np.asarray(found), np.asarray(engine.params.weights), told, state


@pytest.mark.parametrize(
    "costs",
    [
        np.zeros(POPULATION),
        np.repeat([3.0, 1.0, 2.0], 4),
        np.r_[np.full(5, np.nan), np.arange(7.0)],
        np.r_[np.full(6, np.nan), np.full(3, np.inf), 1.0, 1.0, -np.inf],
        np.full(POPULATION, np.nan),
    ],
)
def test_every_weight_is_given_out_once(costs):
    found, expected, _, _ = weights(costs)
    np.testing.assert_array_equal(np.sort(found)[::-1], np.sort(expected)[::-1])


def test_failures_rank_last_and_the_farther_from_the_mean_the_worse():
    costs = np.arange(POPULATION, dtype=np.float64)
    costs[[1, 4, 6, 7, 9]] = [np.nan, np.inf, np.nan, -np.inf, np.nan]
    found, expected, told, state = weights(costs)
    whitened = (told - np.asarray(state.mean)) @ np.linalg.inv(np.linalg.cholesky(np.asarray(state.C, np.float64))).T
    failed = np.flatnonzero(~np.isfinite(costs))
    order = [i for i in np.argsort(costs) if i not in failed]
    order += sorted(failed, key=lambda i: np.linalg.norm(whitened[i]))
    np.testing.assert_array_equal(found[order], expected)


def test_generations_in_which_everything_fails_draw_back_to_the_mean():
    engine, state, _ = anisotropic_state()
    before = cma_es.widest_deviation(draw(engine, state)[1])
    for seed in range(20):
        told, state = draw(engine, state, seed)
        state = cma_es.tell(engine, state, told, np.full(POPULATION, np.nan, np.float32))
    assert cma_es.widest_deviation(state) < 0.5 * before
    assert all(np.all(np.isfinite(leaf)) for leaf in (state.mean, state.std, state.C, state.p_c, state.p_std))


def test_a_distribution_that_has_collapsed_gives_no_nan():
    engine, state, _ = anisotropic_state()
    state = cma_es.on_search_device(state.replace(std=np.float32(1e-30)))
    for seed in range(5):
        told, state = draw(engine, state, seed)
        state = cma_es.tell(engine, state, told, np.zeros(POPULATION, np.float32))
    assert all(np.all(np.isfinite(leaf)) for leaf in (state.mean, state.std, state.C, state.p_c, state.p_std))
    assert state.std >= cma_es.SMALLEST_SIGMA


def test_reentry_keeps_mean_and_shape_and_widens_to_the_floor():
    engine, state, _ = anisotropic_state()
    _, state = draw(engine, state)
    wider = cma_es.reenter(state, 0.01, 0.3)
    assert cma_es.widest_deviation(wider) == pytest.approx(0.3, rel=1e-6)
    assert cma_es.widest_deviation(cma_es.reenter(state, 2.0, 0.3)) == pytest.approx(
        2.0 * cma_es.widest_deviation(state), rel=1e-6
    )
    np.testing.assert_array_equal(wider.mean, state.mean)
    np.testing.assert_array_equal(wider.C, state.C)
    assert not np.any(wider.p_std) and not np.any(wider.p_c)


@pytest.mark.parametrize("failure", [np.nan, np.inf, -np.inf])
def test_a_search_with_a_third_of_its_costs_failing_still_arrives(failure):
    def failing(stage, x, key):
        costs, aux = distance_squared(stage, x, key)
        return np.where(np.asarray(jax.random.uniform(key, costs.shape)) < 1 / 3, failure, costs), aux

    found = es.search(failing, space(), [es.Stage("only", 120, key=1.0)], SETTINGS, jax.random.key(0))
    # without failures it takes half of the generations
    np.testing.assert_allclose(found.best, 1.0, atol=1e-3)
    assert 200 < sum(generation.failed for generation in found.history) < 120 * 12 / 2


def test_a_population_too_small_to_rank_is_refused():
    with pytest.raises(ValueError, match="at least 4, not 3"):
        cma_es.make_engine(3, 2)
