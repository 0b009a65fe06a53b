"""The benchmark of the gaits: its disturbances by hand, its trials against the search's rollout, report and command."""

import json
from importlib import resources
from pathlib import Path

import jax
import numpy as np
import pytest
from typer.testing import CliRunner

from experiments.errors import UserError
from experiments.gait_benchmark import disturbances
from experiments.gait_benchmark.disturbances import SWEEPS, drawn, nominal, swept
from experiments.gait_benchmark.run import GaitResult, find_motions
from experiments.gait_benchmark.trials import GaitTrials, cases, flight_phases, gait_settings, joined
from experiments.model import nominal_model
from experiments.parameter_file import checksum
from experiments.recording import gait_record
from experiments.reports.gait_benchmark import write_gait_benchmark_report
from experiments.tasks.definition import load_task

MODEL = nominal_model()
TRIALS, STRIDE = 8, 0.8
NOISE = {"sensor_noise": np.ones(1, np.float32)}, np.full(1, 7, np.int32)  # the trial of the fixture `trots`


@pytest.fixture(scope="module")
def sweeps():
    """Cases of every sweep of the walking trot's first guess, (levels, trials) each."""
    definition = load_task("walking_trot")
    settings = gait_settings(definition, MODEL, definition.space().initial)
    shape = lambda x: x.reshape(-1, TRIALS, *x.shape[1:])  # noqa: E731
    found = {s.name: swept(s, definition, MODEL, settings, STRIDE, TRIALS) for s in SWEEPS}
    return settings, found, {name: jax.tree.map(shape, case) for name, case in found.items()}


def test_all_parts_of_the_benchmark_fit_into_one_program(sweeps) -> None:
    settings, found, _ = sweeps
    definition = load_task("walking_trot")
    parts = [*found.values(), cases(settings, *drawn(definition, MODEL, 3), 5.0)]
    parts.append(cases(settings, *nominal(definition, MODEL), 5.0))
    whole = joined(parts)
    assert len(whole) == sum(map(len, parts))
    assert all(len(leaf) == len(whole) for leaf in jax.tree.leaves(whole))


def test_pushes_come_from_both_sides_and_all_over_the_stride(sweeps) -> None:
    push = sweeps[2]["push"]
    level = np.array(SWEEPS[0].levels)[:, None]
    np.testing.assert_allclose(np.abs(push.numbers["push_y"]), np.broadcast_to(level, (6, TRIALS)))
    assert (push.numbers["push_y"][-1] > 0).sum() == TRIALS / 2
    start = push.numbers["push_start"][0] - disturbances.MEETING
    np.testing.assert_allclose(start, STRIDE * np.arange(TRIALS) / TRIALS, atol=1e-5)
    end = push.numbers["push_start"] + push.numbers["push_duration"]
    assert np.all(push.duration - end >= 4.0), "time to fall afterwards"


def test_slopes_point_everywhere_and_the_robot_turns_once_round(sweeps) -> None:
    settings, _, shaped = sweeps
    slope = shaped["slope"]
    x, y = slope.numbers["slope_x"], slope.numbers["slope_y"]
    np.testing.assert_allclose(np.degrees(np.arctan(np.hypot(x, y)))[:, 0], SWEEPS[2].levels, atol=1e-4)
    directions = np.sort(np.degrees(np.arctan2(y[-1], x[-1])) % 360.0)
    np.testing.assert_allclose(np.diff(directions), 360.0 / TRIALS, atol=1e-2)
    turned = slope.settings.command.turning * (slope.duration - slope.settings.turn_start)
    assert np.all(turned >= 2 * np.pi)
    assert float(settings.command.turning) == 0.0, "only there"


def test_boards_lie_under_one_side_and_there_is_time_to_pass_them(sweeps) -> None:
    settings, _, shaped = sweeps
    board = shaped["obstacle"]
    np.testing.assert_allclose(board.numbers["obstacle_height"][:, 0], SWEEPS[1].levels)
    y, half = np.abs(board.numbers["obstacle_y"]), 0.5 * board.numbers["obstacle_width"]
    assert np.all(y - half > 0.0), "the feet of the other side, 0.185 m from the middle, pass beside it"
    assert np.all((y - half < 0.185) & (0.185 < y + half))
    far = board.numbers["obstacle_x"] + 0.5 * board.numbers["obstacle_length"]
    assert np.all(settings.command.heading * (board.duration - 2.0) > far + 0.25), "hind feet, 0.25 m behind"


def test_friction_is_that_of_the_ground(sweeps) -> None:
    friction = sweeps[2]["friction"].numbers["ground_friction"][:, 0] * MODEL.numbers.contact.friction
    np.testing.assert_allclose(friction, SWEEPS[3].levels, rtol=1e-6)


def test_flights_are_stretches_but_no_flicker() -> None:
    aloft = np.array([[1, 1, 1, 0, 1, 0, 1, 1], [0] * 8, [1] * 8], bool)
    count, duration = flight_phases(aloft, 0.01)
    np.testing.assert_allclose(count, [2, 0, 1])
    np.testing.assert_allclose(duration, [0.025, np.nan, 0.08])


def test_trials_in_seconds_are_the_searchs_rollout_and_a_fallen_one_stays_fallen(trots) -> None:
    definition, (score, ticks) = trots
    guess = definition.space().initial
    hopeless = guess.copy()
    hopeless[definition.space().names.index("torso_height")] = -1.0
    trials = GaitTrials(MODEL, definition, devices=1, drive="ideal", chunk=3)
    good, bad = (gait_settings(definition, MODEL, values) for values in (guess, hopeless))
    # the third ends in the middle of a second: from then on nothing counts
    outcome = trials.run(joined([cases(good, *NOISE, 4.0), cases(bad, *NOISE, 4.0), cases(good, *NOISE, 2.6)]))
    np.testing.assert_array_equal(outcome.survived, [1.0, 0.0, 1.0])
    assert outcome.speed[0, 0] == pytest.approx(score.metrics["heading_speed"][0], abs=0.01)
    assert outcome.flight_fraction[0] == pytest.approx(score.metrics["flight_fraction"][0], abs=0.01)
    assert outcome.tally.upright[1] == pytest.approx(score.metrics["upright_time"][1], abs=0.01)
    record = gait_record(jax.tree.map(lambda x: x[0], ticks), "ideal")
    here = (record.time >= trials.rollout.task.settled) & (record.time < 2.6 - 1e-6)
    assert outcome.tally.time[2] == pytest.approx(here.sum() * 0.0025, abs=0.005)
    assert outcome.speed[2, 0] == pytest.approx(record.velocity[here, 0].mean(), abs=0.02)


def test_gaits_are_found_by_name_and_others_refused(tmp_path: Path) -> None:
    (motion,) = find_motions(["walking_trot"], MODEL)
    assert motion.definition.task == "walking_trot"
    with pytest.raises(UserError, match="moonwalk"):
        find_motions(["moonwalk"], MODEL)


def test_a_gait_tuned_with_an_own_task_file_is_measured_on_it(tmp_path: Path) -> None:
    longer = load_task("walking_trot").model_copy(update={"duration": 9.0})
    own, path = tmp_path / "own.json", tmp_path / "parameters.json"
    own.write_text(longer.model_dump_json())
    (shipped,) = find_motions(["walking_trot"], MODEL)
    example = resources.files("experiments.examples") / "walking_trot.json"
    content = json.loads(example.read_text()) | {"task_hash": longer.hash()}
    path.write_text(json.dumps(content | {"checksum": checksum(content)}))
    with pytest.raises(UserError, match="by --task FILE"):
        find_motions([str(path)], MODEL)
    (motion,) = find_motions([str(path)], MODEL, str(own))
    assert motion.definition == longer and motion.file.values() == shipped.file.values()


def figures(gait: str, survived: int) -> dict:
    """A gait's figures as the benchmark gives them."""
    points = [
        {"level": x, "trials": 4, "survived": 4 - k // 2, "interval": [0.2, 1.0]}
        for k, x in enumerate(SWEEPS[0].levels)
    ]
    return {
        "gait": gait, "stride": 0.8, "cycles": 20, "trials": 100, "survived": survived, "survived_interval": [0.9, 1.0],
        "initial_guess_survived": 3, "speed_commanded": 0.4, "speed_reached": 0.38, "flight_fraction": 0.0,
        "flight_duration": None, "flights_per_stride": 0.0, "nominal_speed": 0.39,
        "mujoco_c": {"survived": True, "speed": 0.4, "speed_ratio": 1.02},
        "sweeps": [{"disturbance": "push", "unit": "N", "asked": 100.0, "points": points}],
    }  # fmt: skip


def test_report_shows_figures_curves_and_the_gait_in_a_browser(trots, chromium, tmp_path: Path) -> None:
    record = gait_record(jax.tree.map(lambda x: x[0], trots[1][1]), "ideal")
    results = [GaitResult(figures("walking_trot", 100), record), GaitResult(figures("bound", 90), None)]
    page = tmp_path / "report.html"
    write_gait_benchmark_report(page, results, MODEL.numbers, "starleth bench gaits")
    chromium.open(page)
    chromium.wait_for("document.querySelectorAll('.plot .main-svg').length >= 2")
    assert chromium.problems == []
    text = " ".join(chromium.evaluate("document.body.innerText").split())
    for words in ("100 of 100", "90 of 100", "102 % of the speed", "Survival over the disturbance", "MuJoCo C"):
        assert words in text, words
    assert chromium.evaluate("document.querySelectorAll('canvas').length") >= 1


@pytest.mark.slow
def test_command_prints_one_line_per_gait_and_leaves_figures_and_a_report(tmp_path: Path) -> None:
    from experiments.cli.main import app

    words = ["bench", "gaits", "walking_trot", "--trials", "4", "--cycles", "2", "--sweep-trials", "2"]
    result = CliRunner().invoke(app, [*words, "--output", str(tmp_path)], catch_exceptions=False)
    assert result.exit_code == 0
    line = json.loads(result.stdout.splitlines()[-1])
    assert (line["gait"], line["trials"], line["mujoco_c"]["survived"]) == ("walking_trot", 4, True)
    assert [s["disturbance"] for s in line["sweeps"]] == [s.name for s in SWEEPS]
    assert all(p["survived"] == 2 for s in line["sweeps"][:3] for p in s["points"][:1]), "no disturbance, no fall"
    assert json.loads((tmp_path / "gaits.json").read_text()) == [line]
    assert (tmp_path / "report.html").stat().st_size > 100_000
