"""Intervals against closed forms, sensitivity on laws whose answer is known."""

import numpy as np
import pytest

from experiments.robustness.statistics import dependence, influence, paired_difference, success_interval, survival

N = 4000
NOISE_SHARE = 0.02  # a perturbation without influence may explain this much of 4000 trials by chance


@pytest.mark.parametrize("n", [1, 32, 4096])
def test_the_interval_at_the_ends_is_the_closed_form(n: int) -> None:
    # all succeed: the least rate that would do so in 2.5 % of the cases is 0.025^(1/n)
    assert success_interval(n, n) == pytest.approx((0.025 ** (1 / n), 1.0), rel=1e-9)
    assert success_interval(0, n) == pytest.approx((0.0, 1 - 0.025 ** (1 / n)), rel=1e-9)


def test_the_interval_covers_the_truth() -> None:
    rng = np.random.default_rng(0)
    truth, n = 0.97, 100
    intervals = [success_interval(int(k), n) for k in rng.binomial(n, truth, 400)]
    covered = np.mean([low <= truth <= high for low, high in intervals])
    assert covered >= 0.95


def test_influence_finds_what_a_correlation_misses() -> None:
    rng = np.random.default_rng(1)
    push, mass, nothing = rng.uniform(-1, 1, (3, N))
    cost = np.abs(push) + 0.3 * mass + 0.1 * rng.standard_normal(N)
    pushed, heavier, noise = (influence(x, cost) for x in (push, mass, nothing))
    assert abs(pushed.direction) < 0.1 and pushed.share > 0.5
    assert heavier.direction > 0.3 and pushed.share > heavier.share > NOISE_SHARE
    assert noise.share < NOISE_SHARE and noise.p_value > 1e-3 > heavier.p_value


def test_influence_of_an_additive_law_is_its_share_of_the_variance() -> None:
    # for normal inputs ranks and values tell nearly the same story: 0.8^2 of the variance, then 0.6^2
    rng = np.random.default_rng(2)
    a, b = rng.standard_normal((2, 40_000))
    cost = 0.8 * a + 0.6 * b
    assert influence(a, cost).share == pytest.approx(0.64, abs=0.05)
    assert influence(b, cost).share == pytest.approx(0.36, abs=0.05)


def test_what_chance_alone_explains_is_taken_off_the_influence() -> None:
    # ten bins of six trials: uncorrected, chance alone would explain 9 of 50 parts of the variance in the mean
    rng = np.random.default_rng(4)
    shares = [influence(*rng.standard_normal((2, 60))).share for _ in range(200)]
    assert np.mean(shares) < 0.1


@pytest.mark.parametrize("values", [np.ones(100), np.arange(6.0)])
def test_influence_says_nothing_of_what_does_not_vary_or_is_too_few(values) -> None:
    assert influence(values, np.linspace(0, 1, len(values))) is None
    assert influence(np.linspace(0, 1, 100), np.ones(100)) is None


def test_survival_counts_every_trial_once() -> None:
    rng = np.random.default_rng(3)
    size = rng.uniform(0, 100, N)
    curve = survival(size, (size < 60).astype(float))
    assert curve.trials.sum() == N and curve.successes.sum() == (size < 60).sum()
    rate = curve.successes / curve.trials
    assert (rate[:5] == 1).all() and (rate[7:] == 0).all()
    assert (curve.low <= rate).all() and (rate <= curve.high).all()
    assert dependence(curve.trials, curve.successes) < 1e-6


def test_dependence_is_rare_where_there_is_none() -> None:
    rng = np.random.default_rng(4)
    trials = np.full(10, 50)
    found = [dependence(trials, rng.binomial(50, 0.8, 10)) for _ in range(300)]
    assert 0.01 < np.mean(np.array(found) < 0.05) < 0.1  # a p value is uniform: 5 %, 300 times
    assert dependence(trials, trials) == 1.0 and dependence(np.array([50, 0]), np.array([20, 0])) == 1.0


def test_a_paired_difference_covers_the_truth_and_is_narrower_than_what_both_spread() -> None:
    rng = np.random.default_rng(4)
    covered = 0
    for _ in range(60):
        trial = rng.standard_normal(200)
        found = paired_difference(trial, trial + 0.05 * rng.standard_normal(200) - 0.01, np.mean)
        assert found.low < found.value < found.high
        assert found.high - found.low < 0.02  # of single motions: 0.28
        covered += found.low <= -0.01 <= found.high
    assert covered >= 52
