"""From a log to a better model, on short logs: no effect is found where none is, a planted one is."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.errors import UserError
from experiments.independent_plant.generate import write_batch
from experiments.independent_plant.logs import write_log
from experiments.independent_plant.runner import Case
from experiments.independent_plant.sensors import SensorSettings
from experiments.measurement.compare import compare, whiteness
from experiments.measurement.evidence.body_evidence import correlation_rows
from experiments.measurement.evidence.body_replay import DECIMATION, BodyLog, filter_window
from experiments.measurement.evidence.body_rows import knocked
from experiments.measurement.evidence.drive_evidence import rows_that_count
from experiments.measurement.evidence.drive_log import DriveLog
from experiments.measurement.evidence.gather import gather
from experiments.measurement.fits.misfit import misfit
from experiments.measurement.fits.nominal import timing
from experiments.measurement.fits.refit import refit
from experiments.measurement.learn import learn, parse_place
from experiments.measurement.logs.log import Log, SignalTable
from experiments.measurement.logs.log_reader import read_log
from experiments.measurement.logs.noise_floor import estimated, noise_of
from experiments.model import FittedValue, PlacedEffect, load_model, nominal_model, save_model
from mjx_starleth.names import LEGS

DATA = Path(__file__).parents[1] / "data"
SAME_AS_NOISE = 1.45  # residual over noise of a right model: the worst of 36 channels on 600 rows


@pytest.fixture(scope="module")
def log():
    return read_log(DATA / "squat_reference_1500ms.csv.gz")


def wrong_model():
    """The nominal robot and a gear friction that it does not have: for it, the reference lacks friction."""
    extra = PlacedEffect(effect="coulomb_friction", where="all", parameters={"torque": FittedValue(value=0.006)})
    return nominal_model().with_effect(extra)


def test_the_right_model_explains_the_log_down_to_the_noise(log) -> None:
    found = compare(log, nominal_model(), {"coulomb_friction": LIBRARY["coulomb_friction"]})
    drive = found.misfit.drive
    assert drive.max() < SAME_AS_NOISE, drive


def test_a_wrong_model_fails_where_it_is_wrong_and_learning_mends_it(log, tmp_path) -> None:
    library = {"coulomb_friction": LIBRARY["coulomb_friction"]}
    assert compare(log, wrong_model(), library).worst.over_noise > 2.0
    learned = learn([log], nominal_model(), library, [("coulomb_friction", "all")])
    fitted = learned.effects[0].parameters["torque"]
    low, high = fitted.ci95
    assert low < 0.0 < high or abs(fitted.value) < 1e-4, "the reference has no more friction than nominal"
    save_model(tmp_path / "model.json", learned)
    assert load_model(tmp_path / "model.json").hash() == learned.hash()


def test_places_are_parsed() -> None:
    names = nominal_model().joint_names
    assert parse_place("backlash@LH_KFE", LIBRARY, names) == ("backlash", "LH_KFE")
    assert parse_place("payload", LIBRARY, names) == ("payload", "torso")


def test_whiteness_and_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(0)
    noise = 0.3 * rng.standard_normal((4000, 3))
    assert 0.5 < whiteness(noise[:, 0]) < 2.0
    assert whiteness(np.cumsum(noise[:, 0])) > 20.0
    moving = noise + np.sin(np.linspace(0, 60, 4000))[:, None]
    assert abs(estimated(moving) / 0.3 - 1) < 0.1


def test_when_the_loops_run_within_a_row_is_found_on_the_independent_plant(tmp_path) -> None:
    case = Case("air_torque", seed=8, duration=2.0, sensors=SensorSettings(0.3), velocity_phase=3)
    write_batch([case], [1], tmp_path)
    log = read_log(tmp_path / "case_0001.csv.gz")
    evidence = gather(log, nominal_model(), {}, noise_of(log))
    timed = refit([evidence], (), timing(evidence.atoms.effects))
    phase, angle_lead, torque_lag = timed.nominal
    assert phase == pytest.approx(3e-4, abs=2e-5)
    assert (angle_lead, torque_lag) == pytest.approx((5e-5, 5e-5), abs=2e-5), "that plant's steps are exact"
    untimed = refit([evidence], (), ())
    assert misfit(evidence, timed, 0).drive.max() < 1.2 < 4.0 < misfit(evidence, untimed, 0).drive.max()


def test_rows_that_cannot_tell_what_happened_do_not_count() -> None:
    rows, period = 400, 2.5e-3
    turning = np.tile(np.linspace(0.0, 2.0, rows, dtype=np.float32)[:, None], (1, 3))
    log = DriveLog(*(np.zeros_like(turning) for _ in DriveLog._fields))._replace(motor_position=turning)
    log.joint_velocity[100:, 0] = 3.0  # an impact of the first link
    log.position_mode[200:, 1] = 1.0  # the second joint goes over to position mode
    log.motor_position[250:, 2] = log.motor_position[250, 2]  # the third motor comes to rest
    gaps = {joint: np.flatnonzero(rows_that_count(log, period, 0.0)[50:, joint].min(1) == 0) + 50 for joint in range(3)}
    assert [(gap.min(), gap.max()) for gap in gaps.values()] == [(99, 139), (200, 240), (gaps[2].min(), rows - 1)]
    assert 240 < gaps[2].min() < 260
    assert rows_that_count(log, period, 0.0)[300:, 2, :2].all(), "a motor at rest still has an angle and a torque"
    noise = 1e-4  # rad, of an encoder that makes a motor at rest seem to creep
    log.motor_position[:] += noise * np.random.default_rng(0).standard_normal(turning.shape)
    current = rows_that_count(log, period, noise)[:, 2, 2]
    assert not current[270:].any() and current[50:240].all()


def test_a_leg_at_an_end_of_its_joints_or_after_an_impact_tells_nothing() -> None:
    rows, period = 400, 2.5e-3
    still = BodyLog(*(np.zeros((rows, width), np.float32) for width in (19, 18, 18, 12, 4)))
    stops = np.tile([-1.0, 1.0], (12, 1))
    still.q[200, 7 + 4] = 0.995  # a joint of the second leg
    still.u[300:, 6 + 9] = 3.0  # one of the fourth
    found = [knocked(still, period, stops)[:, leg] for leg in range(4)]
    time = (filter_window(period) // 2 + DECIMATION * np.arange(len(found[0]))) * period
    assert not found[0].any() and not found[2].any()
    assert time[found[1]] == pytest.approx(time[np.abs(time - 0.5) < 0.051])
    assert abs(time[found[3]].mean() - 0.75) < 0.01


def test_a_number_that_is_never_accused_can_be_learned_all_the_same(log) -> None:
    library = {name: LIBRARY[name] for name in ("link_com", "bearing_friction")}
    wanted = [("link_com", "HAA"), ("bearing_friction", "all")]
    learned = learn([log], nominal_model(), library, wanted)
    assert [(e.effect, e.where) for e in learned.effects] == wanted
    low, high = learned.effects[1].parameters["coefficient"].ci95
    nominal = nominal_model().numbers.drive.bearing_friction_per_radial_load
    assert low < 1e-4 and high - low < 2.0 * nominal, "the reference plant's bearings do not rub, and the log tells"


def of_bodies(log: Log, rows: int, **changed: SignalTable) -> Log:
    """The first rows of a log without its drives; some signals changed."""
    tables = {signal: table for signal, table in log.signals.items() if not signal.startswith(("command", "motor"))}
    tables |= changed
    tables = {signal: SignalTable(table.names, table.values[:rows]) for signal, table in tables.items()}
    return log.on_time(log.time[:rows], log.sample_period, tables)


@pytest.mark.parametrize("rows", [30, 120, 199])
def test_a_log_too_short_to_be_judged_is_refused(log, rows: int) -> None:
    with pytest.raises(UserError, match="too short to be judged"):
        compare(of_bodies(log, rows), nominal_model(), {})


def test_the_shortest_log_that_is_judged_does_not_hide_a_wrong_torque() -> None:
    log = read_log(DATA / "air_reference_1500ms.csv.gz")
    torque = log.signals["joint_torque"]
    doubled = SignalTable(torque.names, 2.0 * torque.values)
    logs = (of_bodies(log, 200), of_bodies(log, 200, joint_torque=doubled))
    right, wrong = (compare(one, nominal_model(), {}).misfit.worst for one in logs)
    assert 0.0 < right < SAME_AS_NOISE < 4.0 < wrong


def test_a_log_none_of_whose_rows_tell_anything_is_refused(log) -> None:
    flicker = SignalTable(LEGS, np.arange(log.rows)[:, None] // 4 % 2 * np.ones(4))
    with pytest.raises(UserError, match="no channel has rows enough"):
        compare(of_bodies(log, 600, foot_contact=flicker), nominal_model(), {})


@pytest.mark.parametrize("rows", [1, 39, 40, 41, 400])
def test_the_correlation_of_few_rows_is_a_number(rows: int) -> None:
    error = np.random.default_rng(0).standard_normal((3, rows, 2))
    assert np.isfinite(correlation_rows(error)).all()
    assert correlation_rows(np.ones((3, rows, 2))) == pytest.approx(min(rows, 40))


def test_compare_tells_by_how_much_sensors_of_one_motion_are_apart(tmp_path) -> None:
    source = DATA / "air_reference_1500ms"
    log, info = read_log(Path(f"{source}.csv.gz")), json.loads(Path(f"{source}.json").read_text())
    table = {f"{s}/{name}": one.column(name) for s, one in log.signals.items() for name in one.names}
    row = np.arange(log.rows)
    table["joint_velocity/LF_HFE"] = np.interp(row - 0.8, row, table["joint_velocity/LF_HFE"])
    write_log(tmp_path / "late", table, info, log.sample_period)
    command = [sys.executable, "-m", "experiments.cli.main", "compare", str(tmp_path / "late.csv.gz")]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    told = {(d["signal"], d["name"]): d for d in json.loads(ended.stdout)["sensor_delays"]}
    late, prompt = told["joint_velocity", "LF_HFE"], told["joint_velocity", "RF_HFE"]
    assert (late["against"], late["samples"]) == ("joint_position", pytest.approx(0.8, abs=0.1))
    assert late["delay"] == pytest.approx(late["samples"] * log.sample_period, rel=1e-2)
    assert abs(prompt["samples"]) < 0.1
