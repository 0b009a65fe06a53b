"""Robust search: the same trials for all candidates of a generation, judged by the risk asked for; the gate."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from es import Risk, Stage
from experiments.errors import UserError
from experiments.export import Judged
from experiments.model import nominal_model
from experiments.perturbations import load_perturbations
from experiments.rollout import Score
from experiments.tasks.definition import load_task
from experiments.tune import StagedEvaluation, TuneOptions, parse_risk

TRIALS = 8


def staged(risk: Risk, monkeypatch) -> tuple[StagedEvaluation, list]:
    """A search's evaluation whose robot is a formula: the cost of a trial is its torso mass times the first value."""
    definition = load_task("squat_jump").with_trials(TRIALS)
    model = nominal_model()
    options = TuneOptions(definition, model, 0, load_perturbations(None, model), risk=risk, devices=1)
    seen = []

    def scores(members, torque_limit=1.0):
        seen.append(members)
        return Score(members.values[:, 0] * members.numbers["torso_mass"], {}, {})

    monkeypatch.setattr(StagedEvaluation, "on", lambda self, *which: SimpleNamespace(scores=scores))
    return StagedEvaluation(options), seen


@pytest.mark.parametrize("risk", [Risk("mean"), Risk("worst"), Risk("cvar", 0.75)])
def test_candidates_meet_the_same_trials_and_are_judged_by_their_risk(risk: Risk, monkeypatch) -> None:
    evaluate, seen = staged(risk, monkeypatch)
    last = evaluate.options.definition.stages[-1]
    candidates = np.array([[1.0] * 13, [2.0] * 13, [-1.0] * 13], np.float32)
    costs, _ = evaluate(Stage(last.name, 1, last.drive), candidates, jax.random.key(1))
    mass = seen[0].numbers["torso_mass"].reshape(3, TRIALS)
    np.testing.assert_array_equal(mass[0], mass[1])
    assert len(np.unique(mass[0])) == TRIALS
    tail = {"mean": TRIALS, "worst": 1, "cvar": TRIALS // 4}[risk.measure]
    expected = [np.sort(x * mass[0])[-tail:].mean() for x in (1.0, 2.0, -1.0)]
    np.testing.assert_allclose(costs, expected, rtol=1e-6)
    # the next generation meets others
    evaluate(Stage(last.name, 1, last.drive), candidates, jax.random.key(2))
    assert not np.isin(seen[1].numbers["torso_mass"], mass).any()


def test_risk_by_the_words_of_the_command_line() -> None:
    definition = load_task("squat_jump")
    assert parse_risk("mean", None, definition) == Risk("mean")
    assert parse_risk("cvar", None, definition.with_trials(4)) == Risk("cvar", 0.75)
    assert parse_risk("cvar", 0.5, definition.with_trials(4)) == Risk("cvar", 0.5)
    with pytest.raises(UserError, match="give --trials 2 or more"):
        parse_risk("worst", None, definition.with_trials(1))
    with pytest.raises(UserError, match="unknown risk measure 'median'"):
        parse_risk("median", None, definition.with_trials(4))
    with pytest.raises(UserError, match="takes no alpha"):
        parse_risk("worst", 0.5, definition.with_trials(4))


@pytest.mark.parametrize(("failures", "passed"), [(0, True), (1, True), (2, False)])
def test_the_gate_of_a_search_forgives_one_trial_of_128(failures: int, passed: bool) -> None:
    success = np.ones(128)
    success[:failures] = 0.0
    judged = Judged(np.zeros(13), None, Score(np.zeros(128), {}, {"success": success}), {}, required=0.95)
    assert judged.successes == 128 - failures and judged.passed is passed
