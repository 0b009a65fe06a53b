"""The benchmark of the gaits: its disturbances by hand, its motions by name, and its command."""

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
from experiments.gait_benchmark.run import find_motions
from experiments.gait_benchmark.trials import cases, flight_phases, gait_settings, joined
from experiments.model import nominal_model
from experiments.parameter_file import checksum
from experiments.tasks.definition import load_task

MODEL = nominal_model()
TRIALS, STRIDE, SEED = 8, 0.8, 20_000


@pytest.fixture(scope="module")
def sweeps():
    """Cases of every sweep of the walking trot's first guess, (levels, trials) each."""
    definition = load_task("walking_trot")
    settings = gait_settings(definition, MODEL, definition.space().initial)
    shape = lambda x: x.reshape(-1, TRIALS, *x.shape[1:])  # noqa: E731
    found = {s.name: swept(s, definition, MODEL, settings, STRIDE, TRIALS, SEED) for s in SWEEPS}
    return settings, found, {name: jax.tree.map(shape, case) for name, case in found.items()}


def test_all_parts_of_the_benchmark_fit_into_one_program(sweeps) -> None:
    settings, found, _ = sweeps
    definition = load_task("walking_trot")
    parts = [*found.values(), cases(settings, *drawn(definition, MODEL, 3, SEED), 5.0)]
    parts.append(cases(settings, *nominal(definition, MODEL), 5.0))
    whole = joined(parts)
    assert len(whole) == sum(map(len, parts))
    assert all(len(leaf) == len(whole) for leaf in jax.tree.leaves(whole))


def test_a_seed_draws_its_own_trials_and_the_same_again(sweeps) -> None:
    definition = load_task("walking_trot")
    first, again, other = (drawn(definition, MODEL, TRIALS, seed) for seed in (SEED, SEED, SEED + 1))
    np.testing.assert_array_equal(first[0]["push_x"], again[0]["push_x"])
    np.testing.assert_array_equal(first[1], again[1])
    assert not np.isin(other[0]["push_x"], first[0]["push_x"]).any() and not np.isin(other[1], first[1]).all()
    mine = sweeps[1]["push"].numbers["torso_mass"][:TRIALS]
    np.testing.assert_array_equal(mine, first[0]["torso_mass"])


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
