"""Plain against robust searches: who gets which options, and the figures on costs whose answer is known."""

from dataclasses import replace

import numpy as np
import pytest

from es import Risk
from experiments.model import nominal_model
from experiments.perturbations import load_perturbations
from experiments.risk_benchmark import CVAR, PLAIN, ROBUST, figures, rollouts, searches, tail_cost
from experiments.rollout import Score
from experiments.tasks.definition import load_task
from experiments.tune import TuneOptions

TRIALS = 8


@pytest.fixture(scope="module")
def options() -> TuneOptions:
    model = nominal_model()
    return TuneOptions(load_task("squat_jump"), model, 3, load_perturbations("rough", model))


def test_both_searches_differ_in_trials_and_risk_alone(options: TuneOptions) -> None:
    found = searches(options, TRIALS, 2)
    assert list(found) == [(PLAIN, 0), (ROBUST, 0), (PLAIN, 1), (ROBUST, 1)]
    plain, robust = found[PLAIN, 1], found[ROBUST, 1]
    assert plain.seed == robust.seed == 1 and plain.risk == Risk("mean") and robust.risk == CVAR
    assert plain.definition == options.definition
    assert replace(robust, definition=plain.definition, risk=plain.risk) == plain
    assert robust.definition.stages[-1].trials == TRIALS and robust.definition.stages[-1].perturbed
    last = plain.definition.stages[-1]
    more = (TRIALS - last.trials) * last.generations * plain.definition.population
    assert rollouts(robust) - rollouts(plain) == more > 0


def test_figures_are_those_of_the_trials(options: TuneOptions) -> None:
    rng = np.random.default_rng(0)
    cost = rng.normal(size=200)
    success = (cost < 0.5).astype(float)
    # the robust one: dearer by 0.1 everywhere but in the dearest quarter, which it halves
    dearest = cost >= np.quantile(cost, 0.75)
    other = np.where(dearest, 0.5 * cost, cost + 0.1)
    score = Score(np.stack([cost, other]), {}, {"success": np.stack([success, np.ones(200)])})
    told = figures(searches(options, TRIALS, 1), score)
    plain, robust = told["searches"]
    assert plain["cvar_cost"] == pytest.approx(np.sort(cost)[-50:].mean())
    assert robust["success_rate"] == 1.0 and plain["success_rate"] == pytest.approx(success.mean())
    (gain,) = told["cvar_against_plain"]
    assert gain["cvar_cost"]["value"] == pytest.approx(robust["cvar_cost"] - plain["cvar_cost"])
    assert gain["cvar_cost"]["high"] < 0.0
    assert gain["only_cvar_succeeds"] == (1 - success).sum() and gain["only_plain_succeeds"] == 0
    assert tail_cost(np.arange(8.0)) == 6.5
