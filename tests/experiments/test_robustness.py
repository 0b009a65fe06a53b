"""Perturbed trials of a jump: the same bits however they are run, each one again alone, interrupted, resumed, gated."""

import dataclasses
import json
from pathlib import Path

import jax
import jsonschema
import numpy as np
import pytest

from experiments.batch import CHUNK
from experiments.effects import LIBRARY
from experiments.errors import UserError
from experiments.model import nominal_model
from experiments.parameter_file import now, parameter, read_parameters, write_parameters
from experiments.parameter_schema import json_schema
from experiments.perturbations import parse_perturbations
from experiments.robustness import file as robustness_file
from experiments.robustness.analysis import analyse, one_trial, plan
from experiments.robustness.file import RobustnessFile
from experiments.robustness.trials import PerturbedTrials, run_trials
from experiments.run_folder import open_run
from experiments.tasks.definition import load_task

SCHEMA = Path(robustness_file.__file__).parents[1] / "schemas" / "robustness.schema.json"
JUMP = [0.227, 0.273, 0.436, 0.541, 0.291, 0.428, 0.259, 0.251, 0.252, 0.441, 0.47, 0.389, 389.0]
LAWS = {
    "draw": {
        "torso_mass": {"law": "normal", "mean": 1.0, "std": 0.1},
        "push_x": {"law": "uniform", "low": -400.0, "high": 400.0},  # N: some must fall
        "sensor_noise": {"law": "fixed", "value": 1.0},
        "encoder_bias": {"law": "uniform", "low": 0.0, "high": 0.01},
        "slope_y": {"law": "uniform", "low": -0.02, "high": 0.02},
        "obstacle_height": {"law": "uniform", "low": 0.0, "high": 0.01},
        "joint_viscous_drag@all.coefficient": {"law": "uniform", "low": 0.0, "high": 0.1},
    }
}
TRIALS = 24


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory) -> Path:
    """A parameter file of a jump on the ideal drive, the cheapest to compile."""
    folder, definition = tmp_path_factory.mktemp("jump"), load_task("squat_jump")
    write_parameters(
        folder / "parameters.json",
        task="squat_jump",
        robot="starleth",
        model_hash=nominal_model().hash(),
        parameters=[
            parameter(p.name, v, p.unit, p.low, p.high) for p, v in zip(definition.parameters, JUMP, strict=True)
        ],
        metrics={},
        cost_terms={},
        drive="ideal",
        seed=0,
        search={},
        versions={},
        created=now(),
        command="starleth replay .",
    )
    return folder


def planned(run_folder: Path, devices: int, trials: int = TRIALS, gate: float | None = None):
    model = nominal_model()
    laws = parse_perturbations(LAWS, "test", model)
    return plan(run_folder, model, laws, trials, 5, "starleth robustness x", None, None, LIBRARY, devices, gate)


@pytest.fixture(scope="module")
def finished(run_folder, tmp_path_factory):
    """One analysis with a gate on two devices: (folder, what it found, its table of trials)."""
    p = planned(run_folder, 2, gate=0.5)
    folder = tmp_path_factory.mktemp("robustness")
    with open_run(folder, "robustness", p.options.settings(), may_differ=("trials",)) as run:
        found = analyse(p, run, lambda done, successes: None, lambda text: None)
    return folder, found, p


def test_success_is_the_same_to_the_bit_on_one_device(run_folder, finished) -> None:
    _, found, two = finished
    one = planned(run_folder, 1).trials.run(0, TRIALS)
    assert 0 < found.successes < TRIALS, "a rate of 0 or 1 would agree by accident"
    assert int((one["success"] > 0.5).sum()) == found.successes
    table = two.trials.run(0, TRIALS)
    for name in one:
        np.testing.assert_array_equal(one[name], table[name], err_msg=name)
    # a trial run alone is the trial among the others
    assert {w.trial % CHUNK for w in found.worst} - {0}, "one that is not the first of its chunk"
    for worst in found.worst:
        assert one_trial(two, worst.trial, None) == worst.model_dump()
    # every drawn number reaches the plant: no two trials come to the same cost
    assert len(np.unique(one["cost"])) == TRIALS


def test_what_is_written_is_what_was_found(finished, run_folder) -> None:
    folder, found, _ = finished
    content = json.loads((folder / "robustness.json").read_text())
    jsonschema.Draft202012Validator(json.loads(SCHEMA.read_text())).validate(content)
    assert robustness_file.read_robustness(folder / "robustness.json") == found
    assert content["success_rate"] == found.successes / TRIALS
    assert [w["success"] for w in content["worst"]] == sorted(w["success"] for w in content["worst"])
    assert (folder / "report.html").stat().st_size > 10_000
    gated = read_parameters(folder / "parameters.json", allow_ungated=True)
    original = read_parameters(run_folder / "parameters.json", allow_ungated=True)
    assert original.robustness_gate is None
    assert gated.values() == original.values()
    assert gated.robustness_gate.passed == (found.ci95[0] >= 0.5)
    assert gated.robustness_gate.trials == TRIALS


def test_the_published_schema_is_the_files() -> None:
    assert json.loads(SCHEMA.read_text()) == json_schema(RobustnessFile, robustness_file.SCHEMA_ID)


def test_finished_trials_are_kept_and_damaged_ones_run_again(finished, monkeypatch) -> None:
    folder, found, p = finished
    block = next((folder / "trials").iterdir())
    whole = block.read_bytes()
    ran = []
    original = PerturbedTrials.run
    monkeypatch.setattr(PerturbedTrials, "run", lambda self, a, n: ran.append((a, n)) or original(self, a, n))

    def again(trials: int):
        told = []
        some = PerturbedTrials(dataclasses.replace(p.options, trials=trials))
        some.evaluation = p.trials.evaluation  # compiled
        with open_run(folder, "robustness", some.options.settings(), may_differ=("trials",)) as run:
            outcome = run_trials(some, run, lambda done, successes: None, told.append)
        return outcome, told

    outcome, told = again(TRIALS)
    assert (ran, told, outcome.successes) == ([], [], found.successes)
    fewer, _ = again(TRIALS - 4)
    assert ran == [] and fewer.trials == TRIALS - 4
    for torn in (whole[: len(whole) // 2], whole[:100] + bytes([whole[100] ^ 1]) + whole[101:], b""):
        ran.clear()
        block.write_bytes(torn)
        outcome, told = again(TRIALS)
        assert ran == [(0, TRIALS)] and "damaged" in told[0]
        assert outcome.successes == found.successes
        assert block.read_bytes() == whole, "run again, the block must be the same to the bit"


def test_a_gate_speaks_for_the_model_and_drive_tuned_on(run_folder) -> None:
    model = nominal_model()
    numbers = model.numbers.model_copy(update={"gravity": 9.8})
    other = model.model_copy(update={"numbers": numbers})
    laws = parse_perturbations(LAWS, "test", other)
    arguments = (run_folder, other, laws, 8, 0, "", None, None, LIBRARY, 1)
    assert plan(*arguments, None).options.model.hash() != model.hash()
    with pytest.raises(UserError, match="a gate speaks for the model"):
        plan(*arguments, 0.9)
    arguments = (run_folder, model, laws, 8, 0, "", None, "full", LIBRARY, 1)
    assert plan(*arguments, None).options.drive == "full"
    with pytest.raises(UserError, match="speaks for the drive that the motion was tuned on, ideal"):
        plan(*arguments, 0.9)


def test_trials_depend_on_seed_index_and_name_only() -> None:
    laws = parse_perturbations(LAWS, "test", nominal_model())
    fewer = parse_perturbations({"draw": {"slope_y": LAWS["draw"]["slope_y"]}}, "test", nominal_model())
    key = jax.random.key(3)
    many, start_many = laws.columns(key, 50)
    late, start_late = laws.columns(key, 5, first=40)
    alone, _ = fewer.columns(key, 50)
    for name in many:
        np.testing.assert_array_equal(late[name], many[name][40:45])
    np.testing.assert_array_equal(start_late, start_many[40:45])
    np.testing.assert_array_equal(alone["slope_y"], many["slope_y"])
    other, _ = laws.columns(jax.random.key(4), 50)
    assert (other["torso_mass"] != many["torso_mass"]).all()
