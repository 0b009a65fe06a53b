"""One trot on its own senses, and a fall: what the score says of them, the benchmark's trials and both reports."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.gait_benchmark.disturbances import SWEEPS
from experiments.gait_benchmark.run import GaitResult
from experiments.gait_benchmark.trials import GaitTrials, cases, gait_settings, joined
from experiments.imu_sensing import make_sensing
from experiments.model import nominal_model
from experiments.parameter_file import now, parameter, write_parameters
from experiments.parameter_schema import Metric
from experiments.plant import make_plant
from experiments.recording import gait_record
from experiments.reports.gait import last_strides, stride_duration, write_gait_report
from experiments.reports.gait_benchmark import write_gait_benchmark_report
from experiments.rollout import Rollout
from experiments.tasks.definition import load_task
from experiments.tasks.registry import make_task
from experiments.trial import Trial, noise_table

MODEL = nominal_model()
CONTACT = 10.0  # N
NOISE_START = 7  # row of the sensor noise
NOISE = {"sensor_noise": np.ones(1, np.float32)}, np.full(1, NOISE_START, np.int32)  # the same as a benchmark's trial


@pytest.fixture(scope="module")
def trots():
    """(definition, (score, ticks)) of a trot on the ideal drive with the robot's own, noisy senses, and of a candidate
    whose legs give way at once, which no rounding delays."""
    definition = load_task("walking_trot").model_copy(update={"duration": 4.0})
    task = make_task(definition, MODEL)
    rollout = Rollout(make_plant(MODEL, "ideal"), task, make_sensing("estimated", MODEL))
    values = np.stack([definition.space().initial] * 2)
    values[1, definition.space().names.index("torso_height")] = -1.0
    noise = Trial({"sensor_noise": jnp.float32(1.0)}, noise_table(), jnp.int32(NOISE_START))
    run = jax.jit(jax.vmap(lambda v: rollout.record(rollout.plant.params, task.settings, v, noise)))
    return definition, jax.tree.map(np.asarray, run(jnp.asarray(values)))


def test_a_trot_keeps_its_plan_and_speed_with_its_own_senses(trots) -> None:
    _, (score, ticks) = trots
    record = gait_record(jax.tree.map(lambda x: x[0], ticks), "ideal")
    late = record.time > 2.2
    contact = np.linalg.norm(record.contact_force[late], axis=-1) >= CONTACT
    assert score.metrics["survived"][0] == 1.0
    assert (contact == record.planned_stance[late]).mean() > 0.9
    assert 0.15 < record.velocity[late, 0].mean() < 0.45
    # the filter knows the velocity to a tenth of the speed
    error = (record.estimated_velocity - record.velocity)[late, :2]
    assert np.sqrt((error**2).mean()) < 0.04
    # what the score says is what the recording shows
    assert score.metrics["heading_speed"][0] == pytest.approx(record.velocity[late, 0].mean(), abs=0.02)
    np.testing.assert_allclose(
        score.metrics["schedule_mismatch"][0], (contact != record.planned_stance[late]).mean(), atol=0.02
    )


def test_a_fall_is_graded_and_finite(trots) -> None:
    _, (score, _) = trots
    assert np.isfinite(score.cost).all()
    assert score.metrics["survived"][1] == 0.0
    assert score.cost[1] > score.cost[0] + 20.0
    np.testing.assert_allclose(score.cost, sum(score.terms.values()), rtol=1e-5)


def test_the_gaits_report_shows_it_in_a_browser(trots, chromium, tmp_path: Path) -> None:
    definition, (score, ticks) = trots
    record = gait_record(jax.tree.map(lambda x: x[0], ticks), "ideal")
    assert stride_duration(record) == pytest.approx(
        definition.space().named(definition.space().initial)["cycle_duration"], abs=3e-3
    )
    assert len(last_strides(record, 2)) == 2
    space = definition.space()
    file = write_parameters(
        tmp_path / "parameters.json",
        task="walking_trot", robot="starleth", model_hash=MODEL.hash(), drive="ideal", seed=0, created=now(),
        parameters=[parameter(p.name, p.initial, p.unit, p.low, p.high) for p in definition.parameters],
        metrics={"heading_speed": Metric(value=float(score.metrics["heading_speed"][0]), unit="m/s")},
        cost_terms={name: float(value[0]) for name, value in score.terms.items()},
        search={}, versions={}, command="starleth replay run",
    )  # fmt: skip
    assert file.values() == pytest.approx(space.named(space.initial))
    page = tmp_path / "report.html"
    write_gait_report(page, file, MODEL.numbers, record)
    chromium.open(page)
    chromium.wait_for("document.querySelectorAll('.plot .main-svg').length >= 4")
    assert chromium.problems == []
    assert all(address.startswith(("file:", "data:", "blob:")) for address in chromium.requests)
    assert "Walking trot" in chromium.evaluate("document.title")


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


def test_the_benchmarks_report_shows_figures_curves_and_the_gait_in_a_browser(trots, chromium, tmp_path: Path) -> None:
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
