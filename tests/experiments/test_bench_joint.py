"""What is hidden in the efforts of a rigid joint on a bench is found, and nothing else."""

import json
from dataclasses import replace

import pytest
from rigid_bench import (
    BIAS,
    COULOMB,
    ENCODER,
    GEARED,
    GRAVITY,
    INERTIA,
    SILENT,
    VISCOUS,
    bench_log,
)

from experiments.cli.measuring_tables import fitted_lines, show_comparison
from experiments.effects.bench import bench_effects, elastic_effects
from experiments.effects.library import LIBRARY
from experiments.measurement.checks.check import check
from experiments.measurement.compare import compare
from experiments.measurement.diagnose import diagnose
from experiments.measurement.evidence.gather import model_for
from experiments.measurement.learn import learn
from experiments.measurement.logs.log import Log
from experiments.model import load_model, nominal_model, save_model
from experiments.reports.diagnosis import write_diagnosis_report


@pytest.fixture(scope="module")
def faulty() -> Log:
    return bench_log(COULOMB, BIAS)


def test_the_right_model_lacks_nothing() -> None:
    log = bench_log()
    found = diagnose([log], model_for(log, nominal_model()), GEARED, SILENT)
    assert found.verdict == "none" and not found.effects
    assert found.answer["fit_percent"][0]["all"] > 98.0


def test_a_drive_that_filters_its_log_below_the_noise_it_states_is_believed() -> None:
    log = bench_log()
    assert check(replace(log, noise_std={"joint_position": 1e3 * ENCODER}), {}) == []


def test_numbers_that_are_a_little_off_are_no_effect() -> None:
    log = bench_log()
    off = {"inertia": 1.08 * INERTIA, "viscous_friction": 0.93 * VISCOUS, "gravity_load": 1.09 * GRAVITY}
    log = replace(log, joint=log.joint.model_copy(update=off))
    found = diagnose([log], model_for(log, nominal_model()), GEARED, SILENT)
    assert found.verdict == "none" and not found.effects, found.answer


def test_a_law_that_effects_of_the_library_only_imitate_is_unknown() -> None:
    log = bench_log(cable=1.0)
    found = diagnose([log], model_for(log, nominal_model()), GEARED, SILENT)
    assert found.verdict == "unknown" and found.answer["effects"] == [], found.answer
    assert any("position" in hint["input"] for hint in found.answer["rest_goes_with"])


def test_both_hidden_frictions_are_named_and_measured(faulty) -> None:
    found = diagnose([faulty], model_for(faulty, nominal_model()), GEARED, SILENT)
    named = {entry["effect"]: entry for entry in found.answer["effects"]}
    assert set(named) == {"coulomb_friction", "direction_dependent_viscous_friction"}
    assert {entry["where"] for entry in named.values()} == {"axis"}
    assert named["coulomb_friction"]["parameters"]["torque"]["value"] == pytest.approx(COULOMB, rel=0.02)
    assert named["direction_dependent_viscous_friction"]["parameters"]["coefficient"]["value"] == pytest.approx(
        BIAS, rel=0.05
    )
    errors = [found.answer["effects"][0]["held_out_error_before"], found.answer["effects"][-1]["held_out_error_after"]]
    assert errors[0] > 3.0 * errors[1] and errors[1] < 1.5


def test_an_effect_is_proven_on_a_log_that_it_was_not_fitted_to_and_refuted_by_one(tmp_path) -> None:
    effects = {"coulomb_friction": LIBRARY["coulomb_friction"]}
    worn = bench_log(COULOMB)
    model = model_for(worn, nominal_model())
    found = diagnose([worn, bench_log(COULOMB, start=20.0)], model, effects, SILENT)
    (entry,) = found.answer["effects"]
    assert {u["log"] for u in entry["other_experiments"]} == {"bench_0", "bench_20"}
    assert all(u["error_after"] < 0.5 * u["error_before"] for u in entry["other_experiments"]), entry
    write_diagnosis_report(tmp_path / "report.html", found)
    assert "Fitted to the other logs alone" in (tmp_path / "report.html").read_text()
    refuted = diagnose([worn, bench_log(start=20.0)], model, effects, SILENT)
    assert refuted.verdict == "unknown" and refuted.answer["effects"] == []
    assert refuted.answer["refuted"] == [{"effect": "coulomb_friction", "where": "axis", "log": "bench_20"}]
    assert "makes bench_20 worse" in refuted.text


@pytest.mark.parametrize(
    ("hidden", "told"), [({"coulomb": COULOMB}, "direction of motion"), ({"cable": 1.0}, "position")]
)
def test_what_nothing_explains_is_told_with_what_it_goes_with(hidden, told) -> None:
    log = bench_log(**hidden)
    found = diagnose([log], model_for(log, nominal_model()), {"torque_ripple": LIBRARY["torque_ripple"]}, SILENT)
    (hint,) = found.answer["rest_goes_with"]
    assert found.verdict == "unknown" and told in hint["input"] and abs(hint["correlation"]) > 0.5, found.answer
    assert f"the {hint['input']}" in found.text


def test_a_rigid_joint_shows_no_number_of_a_spring() -> None:
    springs = {"spring_stiffness", "spring_damping"}
    assert springs <= set(elastic_effects(LIBRARY))
    rigid = bench_effects(LIBRARY, prismatic=False)
    assert not springs & set(rigid) and {"motor_inertia", "coulomb_friction", "gravity_load"} <= set(rigid)


def test_a_learned_model_makes_the_error_fall_and_says_so(faulty, tmp_path, capsys) -> None:
    nominal = model_for(faulty, nominal_model())
    wanted = [("coulomb_friction", "axis"), ("direction_dependent_viscous_friction", "axis")]
    learned = learn([faulty], nominal, GEARED, wanted)
    save_model(tmp_path / "model.json", learned)
    again = load_model(tmp_path / "model.json")
    assert json.loads((tmp_path / "model.json").read_text())["joint"]["name"] == "axis"
    before, after = (compare(faulty, model, GEARED) for model in (nominal, again))
    assert after.worst.over_noise < 0.2 * before.worst.over_noise
    assert after.channels[0].fit > before.channels[0].fit
    show_comparison(after, before)
    shown = capsys.readouterr().err
    assert "without" in shown and f"{before.worst.over_noise:.2f}" in shown
    lines = fitted_lines(learned.effects, wanted)
    assert len(lines) == 2 and lines[0].startswith("coulomb_friction at axis: torque 0.35"), lines
