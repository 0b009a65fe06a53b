"""The diagnosis on logs of the independent plant, which shares no code with the model, and its benchmark."""

import json
from pathlib import Path

import numpy as np
import pytest

from experiments.diagnosis_benchmark.beyond_log import beyond_log, jump
from experiments.diagnosis_benchmark.run import run
from experiments.effects.library import LIBRARY
from experiments.errors import UserError
from experiments.files import write_json
from experiments.independent_plant.generate import write_batch
from experiments.independent_plant.library import Effect
from experiments.independent_plant.numbers import BodyNumbers
from experiments.independent_plant.runner import Case
from experiments.measurement.answer import answer_of
from experiments.measurement.diagnose import Diagnosis, diagnose
from experiments.measurement.evidence.gather import library_for, model_for
from experiments.measurement.intake import read_checked
from experiments.model import FittedValue, PlacedEffect, nominal_model, save_model
from experiments.replay import replay
from experiments.tasks.definition import load_task

DURATION = 4.0  # s


def diagnosed(folder: Path, case: Case) -> Diagnosis:
    write_batch([case], [1], folder)
    log = read_checked(folder / "case_0001.csv.gz", None, nominal_model())
    model = model_for(log, nominal_model())
    return diagnose([log], model, library_for(model, LIBRARY), lambda text: None)


@pytest.mark.slow  # the robot that is ten percent off asks more of the diagnosis
def test_a_robot_without_a_hidden_effect_lacks_nothing(tmp_path) -> None:
    found = diagnosed(tmp_path, Case("air", seed=3, duration=DURATION))
    assert found.verdict == "none" and found.answer["effects"] == []


def test_a_robot_that_is_ten_percent_off_its_data_sheet_lacks_nothing(tmp_path) -> None:
    off = {
        "motor_inertia": (1.1, 0.9, 0.95),
        "friction_coulomb": (0.9, 1.1, 1.05),
        "torque_constant": (0.95, 1.1, 0.9),
        "spring_stiffness": (1.05, 0.93, 1.1),
    }
    bodies = BodyNumbers(link_mass=np.array([1.05, 0.9, 1.1]), link_com=np.array([0.95, 1.1, 0.9]))
    case = Case("air_torque", seed=6, duration=DURATION, off=off, bodies=bodies, velocity_phase=2)
    found = diagnosed(tmp_path, case)
    assert found.verdict == "none" and found.answer["effects"] == []
    assert found.answer["held_out_rms"] < 1.05


def test_hidden_friction_is_named_placed_and_measured(tmp_path) -> None:
    hidden = Effect("coulomb_friction", "HFE", {"level": 0.004})
    found = diagnosed(tmp_path, Case("air", effects=(hidden,), seed=4, duration=DURATION))
    (entry,) = found.answer["effects"]
    assert (found.verdict, entry["effect"], entry["where"]) == ("explained", "coulomb_friction", "HFE")
    assert set(found.answer) == set(answer_of("explained", "", ""))
    low, high = entry["parameters"]["torque"]["ci95"]
    assert low - 1e-4 < 0.004 < high + 1e-4 and high - low < 4e-4
    assert found.answer["held_out_rms"] < 1.05


def test_a_bench_joint_is_diagnosed_behind_its_spring(tmp_path) -> None:
    hidden = Effect("spring_stiffness", "all", {"change": -0.2})
    found = diagnosed(tmp_path, Case("bench_KFE", effects=(hidden,), seed=5, duration=8.0))  # its motor rests often
    (entry,) = found.answer["effects"]
    assert (entry["effect"], entry["where"]) == ("spring_stiffness", "axis")
    low, high = entry["parameters"]["relative"]["ci95"]
    assert low < -0.2 < high and high - low < 0.05


def test_the_benchmark_scores_against_a_truth_that_no_diagnosis_sees_and_resumes(tmp_path) -> None:
    said: list[str] = []
    result = run(tmp_path, 2, 0, DURATION, ["diagnosis"], 1, said.append)
    assert not list((tmp_path / "logs").glob("*truth*")) and (tmp_path / "truth.json").exists()
    (row,) = result["methods"]
    truth = json.loads((tmp_path / "truth.json").read_text())["cases"]
    told = {n: json.loads((tmp_path / "answers" / f"{n}.json").read_text())["diagnosis"]["effects"] for n in truth}
    clear = [n for n, c in truth.items() if c["group"] == "single" and c["effects"][0]["strength"] >= 0.05]
    hits = [n for n in clear if told[n] and told[n][0]["effect"] == truth[n]["effects"][0]["effect"]]
    assert row["method"] == "diagnosis" and row["right_effect_first"] == [len(hits), len(clear)]
    answers = {path: path.stat().st_mtime_ns for path in (tmp_path / "answers").iterdir()}
    assert len(answers) == 2
    assert run(tmp_path, 2, 0, DURATION, ["diagnosis"], 1, said.append) == result
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "answers").iterdir()} == answers
    with pytest.raises(UserError, match="another benchmark"):
        run(tmp_path, 3, 0, DURATION, ["diagnosis"], 1, said.append)
    with pytest.raises(UserError, match="No method"):
        run(tmp_path, 2, 0, DURATION, ["oracle"], 1, said.append)


@pytest.mark.slow
def test_a_jump_on_the_independent_plant_is_that_of_the_model_and_friction_lowers_it() -> None:
    definition, model = load_task("squat_jump"), nominal_model()
    values = definition.space().initial
    score, _ = replay(values, definition, model, "full", "moreau", LIBRARY)
    sound = jump(values, definition, model, ())
    worn = jump(values, definition, model, (Effect("coulomb_friction", "all", {"level": 0.006}),))
    assert sound.apex_height == pytest.approx(float(score.metrics["apex_height"]), abs=0.03)
    assert worn.apex_height < sound.apex_height - 0.01


@pytest.mark.slow
def test_jumps_of_both_models_are_tuned_and_replayed_on_the_robot_whose_diagnosis_is_kept(tmp_path) -> None:
    hidden = Effect("torque_sensor_gain", "all", {"change": 0.2})
    mine = tmp_path / "torque_sensor_gain@all,change=0.2"
    (mine / "log").mkdir(parents=True)
    (mine / "log/case_0001.csv.gz").touch()
    write_json(mine / "diagnosis.json", {"verdict": "explained", "effects": []})
    gain = {"relative": FittedValue(value=0.2, unit="-")}
    learned = PlacedEffect(effect="torque_sensor_gain", where="all", parameters=gain)
    save_model(mine / "model.json", nominal_model().with_effect(learned))
    found = beyond_log(tmp_path, hidden, 4, 0, 1, lambda text: None)
    assert found["learned_effects"] == ["torque_sensor_gain@all"] and found["verdict"] == "explained"
    nominal, other = found["nominal"], found["learned"]
    assert not nominal["fallen"] and not other["fallen"]
    assert nominal["height"] == pytest.approx(nominal["apex"] - 0.42, abs=1e-3)
    lost = found["nominal_without_effect"]["height"] - nominal["height"]
    assert found["lost"] == pytest.approx(lost, abs=1e-3) and lost > 0.02
    assert found["won_back_share"] == pytest.approx((other["height"] - nominal["height"]) / lost, abs=0.01)
    with pytest.raises(UserError, match="another robot"):
        beyond_log(tmp_path, hidden, 4, 1, 1, lambda text: None)
