"""The paper's bound handling: redraw, then project and charge."""

import jax
import numpy as np
import pytest
import scipy.stats
from es_problems import POPULATION, SIZE, space

import es
from es import bounds, cma_es

HIGH = np.ones(SIZE, np.float32)


def ask(mean: float, sigma: float, redraws: int, seed: int = 0, high: np.ndarray = HIGH):
    engine = cma_es.make_engine(POPULATION, SIZE)
    state = cma_es.start(engine, np.full(SIZE, mean, np.float32), sigma)
    key = jax.device_put(jax.random.key(seed), cma_es.search_device())
    draw, state = bounds.ask(engine, state, key, np.int32(7), high, np.int32(redraws))
    return jax.tree.map(np.asarray, draw), engine, state, jax.random.fold_in(key, 7)


def redrawn_one_by_one(engine, state, key, redraws: int):
    """The same in plain Python: attempt after attempt until it is inside or none is left."""
    with cma_es.library_numerics():
        told = np.array(engine.draw(key, state))
        counts = np.zeros(POPULATION, int)
        for attempt in range(1, redraws + 1):
            samples = np.asarray(engine.draw(jax.random.fold_in(key, attempt), state))
            for i in range(POPULATION):
                if np.any(told[i] < 0.0) or np.any(told[i] > 1.0):
                    told[i], counts[i] = samples[i], attempt
    return told, counts


# one chunk, several, a last one that is not whole; at 0.9 some candidates are never inside
@pytest.mark.parametrize(("mean", "redraws"), [(0.5, 20), (0.9, 100), (0.9, 2), (1.0, bounds.CHUNK)])
def test_each_candidate_takes_the_first_of_its_own_redraws_that_is_inside(mean, redraws):
    draw, engine, state, key = ask(mean, 0.4, redraws)
    told, counts = redrawn_one_by_one(engine, state, key, redraws)
    # the vectorised draw may round differently in the last bit
    np.testing.assert_allclose(draw.told, told, atol=1e-6)
    np.testing.assert_array_equal(draw.redraws, counts)
    assert counts.any()


def test_redrawn_samples_follow_the_truncated_normal():
    samples = np.concatenate([ask(0.9, 0.3, 1000, seed)[0].told for seed in range(200)])
    law = scipy.stats.truncnorm((0.0 - 0.9) / 0.3, (1.0 - 0.9) / 0.3, loc=0.9, scale=0.3)
    # the coordinates are independent, so each follows this law; by chance one in a thousand would fail (fixed seeds)
    assert all(scipy.stats.kstest(samples[:, i], law.cdf).pvalue > 1e-3 for i in range(SIZE))


def test_after_a_thousand_redraws_the_last_is_projected_and_charged_by_its_distance():
    draw, *_ = ask(1.5, 0.01, 1000)  # fifty standard deviations outside
    np.testing.assert_array_equal(draw.redraws, 1000)
    np.testing.assert_array_equal(draw.inside, 1.0)
    np.testing.assert_allclose(draw.distance, np.linalg.norm(draw.told - 1.0, axis=-1), rtol=1e-5)
    assert np.all(draw.distance > 0.9)  # 0.5 in each of four coordinates


def test_what_is_inside_is_left_alone():
    draw, *_ = ask(0.5, 0.01, 1000)
    np.testing.assert_array_equal(draw.redraws, 0)
    np.testing.assert_array_equal(draw.distance, 0.0)
    assert draw.inside.tobytes() == draw.told.tobytes()


@pytest.mark.parametrize("redraws", [0, 1000])
def test_a_search_finds_an_optimum_in_the_corner_by_either_way(redraws):
    """The cost falls towards a point outside in every coordinate; with 0 redraws only projection is at work."""
    settings = es.SearchSettings(population=POPULATION, redraws=redraws, bound_penalty=1.0)
    found = es.search(
        lambda stage, x, key: (np.sum((x - 3.0) ** 2, axis=-1), None),
        space(initial=0.0),
        [es.Stage("only", 120)],
        settings,
        jax.random.key(0),
    )
    # 1 % of the range of 3 short of the corner (2, ..., 2); learning from the projected points stops far from there
    np.testing.assert_allclose(found.best, 2.0, atol=0.03)
    assert all(np.all(generation.stage_best <= 2.0) for generation in found.history)
    assert redraws or sum(generation.projected for generation in found.history) > 100


def test_the_charge_decides_between_candidates_that_project_to_the_same_cost():
    """A flat cost: only the charge can bring the mean back from where the projections are."""

    def drift(penalty: float) -> float:
        settings = es.SearchSettings(population=POPULATION, redraws=0, bound_penalty=penalty, sigma=0.5)
        box = space(initial=2.0)
        found = es.search(
            lambda stage, x, key: (np.zeros(len(x)), None), box, [es.Stage("only", 30)], settings, jax.random.key(3)
        )
        return sum(generation.projected for generation in found.history[10:])

    assert drift(1.0) < 0.2 * drift(0.0)
