"""The refinement as a step of its own: goes on where it was killed, never on a damaged file; what it tells."""

import json
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from es import Parameter, ParameterSpace, Refined, Risk
from experiments import refinement
from experiments.refinement import FILE, SAMPLES, RefinementInterrupted, TrueCost, descend, verdict

SPACE = ParameterSpace(tuple(Parameter(f"p{i}", "m", -1.0, 2.0, 0.5) for i in range(3)))
STEPS = 12


class Formula:
    """A true cost and its slope without a robot."""

    space = SPACE

    def __init__(self, evaluation, population: int) -> None:
        self.evaluation = evaluation

    def costs(self, x):
        return np.sum((np.asarray(x, np.float64) - 0.2) ** 2, -1)

    def slope(self, x, step):
        return 2 * (np.asarray(x, np.float64) - 0.2) * [1.0, 3.0, 0.5]


@pytest.fixture
def formula(monkeypatch):
    monkeypatch.setattr(refinement, "TrueCost", Formula)


def run_descent(folder, steps=STEPS, on_step=lambda descent: None, said=None) -> Refined:
    folder.mkdir(exist_ok=True)
    return descend(None, folder, SPACE.initial, steps, on_step, (said if said is not None else []).append)


def test_killed_after_any_step_it_ends_with_the_same_bits(formula, tmp_path) -> None:
    whole = run_descent(tmp_path / "whole")
    assert whole.improved

    def interrupt(descent):
        if len(descent.history) == 5:
            raise KeyboardInterrupt

    with pytest.raises(RefinementInterrupted) as interrupted:
        run_descent(tmp_path / "cut", on_step=interrupt)
    assert interrupted.value.steps == 5
    again = run_descent(tmp_path / "cut")
    assert again.best.tobytes() == whole.best.tobytes() and again.history == whole.history


@pytest.mark.parametrize("damage", ["torn", "other start", "a key too many", "text for a number"])
def test_a_file_that_cannot_be_used_is_named_and_not_used(formula, tmp_path, damage: str) -> None:
    run_descent(tmp_path, steps=3)
    path, said = tmp_path / FILE, []
    content = json.loads(path.read_text())
    match damage:
        case "torn":
            path.write_bytes(path.read_bytes()[:-40])
        case "other start":
            path.write_text(json.dumps(content | {"start": [0.1, 0.1, 0.1]}))
        case "a key too many":
            path.write_text(json.dumps(content | {"extra": 1}))
        case "text for a number":
            path.write_text(json.dumps(content | {"cost": "low"}))
    found = run_descent(tmp_path, steps=3, said=said)
    assert len(said) == 1 and FILE in said[0] and "anew" in said[0]
    assert found.initial_cost == pytest.approx(3 * 0.3**2)


def test_it_says_plainly_what_became_of_it() -> None:
    start = np.zeros(3, np.float32)
    assert verdict(Refined(start, -6.78, -6.73, ()), True) == "Refined: -6.730 → -6.780."
    assert "did not lower the cost" in verdict(Refined(start, -6.73, -6.73, ()), False)
    assert "no better on unseen" in verdict(Refined(start, -6.78, -6.73, ()), False)


def test_slopes_are_those_of_the_trials_that_count(monkeypatch) -> None:
    """Under the worst case: only the worst trial's, at points near the values; one wild slope is cut to size."""
    cost = TrueCost.__new__(TrueCost)
    cost.risk, cost.seed, cost.space, cost.population = Risk("worst"), 0, SPACE, 4
    cost.stage = SimpleNamespace(torque_limit=1.0)
    cost.numbers, cost.noise = {"k": np.array([1.0, 7.0, 2.0], np.float32)}, np.zeros(3, np.int32)
    x = np.array([0.1, 0.2, 0.3], np.float32)
    cost._seen = {x.tobytes(): np.array([0.0, 9.0, 1.0])}

    def slopes(members, limit):
        assert set(members.numbers["k"]) == {7.0} and len(members.values) == SAMPLES
        np.testing.assert_array_equal(members.values[0], x)
        assert 0 < np.abs(members.values[1:] - x).max() < 0.1
        found = np.tile([3.0, 0.0, 0.0], (SAMPLES, 1))
        found[1], found[2] = [0.0, 1e9, 0.0], np.nan
        return found

    cost.smooth = SimpleNamespace(slopes=slopes)
    np.testing.assert_allclose(cost.slope(x, 0), [2.0, 1.0, 0.0], rtol=1e-6)


def test_what_cannot_be_refined_is_refused(tmp_path) -> None:
    words = ["tune", "squat_jump", "--generations", "0", "--output", str(tmp_path / "run")]
    ended = subprocess.run(
        [sys.executable, "-m", "experiments.cli.main", *words], capture_output=True, text=True, timeout=120
    )
    assert ended.returncode == 2 and "give it --refine" in ended.stderr and not (tmp_path / "run").exists()
