"""Logs that lack a joint's column: what they do not tell is not judged, and never taken for zeros."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.errors import UserError
from experiments.measurement.compare import Comparison, compare
from experiments.measurement.evidence.body_replay import body_log, shows_bodies
from experiments.measurement.evidence.drive_log import channels_logged, drive_log
from experiments.measurement.fits.fit_types import Placed, Refitted
from experiments.measurement.learn import _refuse_untold, learn
from experiments.measurement.logs.log import Log, SignalTable
from experiments.measurement.logs.log_reader import read_log
from experiments.measurement.logs.noise_floor import noise_of
from experiments.model import nominal_model
from mjx_starleth.names import LEGS

SQUAT = Path(__file__).parents[1] / "data" / "squat_reference_1500ms.csv.gz"
JOINT = "RF_HFE"


@pytest.fixture(scope="module")
def log() -> Log:
    return read_log(SQUAT)


@pytest.fixture(scope="module")
def whole(log: Log) -> Comparison:
    return compare(log, nominal_model(), {})


def without(log: Log, signal: str, name: str = JOINT) -> Log:
    table = log.signals[signal]
    keep = [i for i, other in enumerate(table.names) if other != name]
    less = SignalTable(tuple(table.names[i] for i in keep), table.values[:, keep])
    return log.on_time(log.time, log.sample_period, {**log.signals, signal: less})


def with_rows(log: Log, signal: str, rows: list[int] | slice, value: float = np.nan) -> Log:
    table = log.signals[signal]
    values = table.values.copy()
    values[rows, table.names.index(JOINT)] = value
    return log.on_time(log.time, log.sample_period, {**log.signals, signal: SignalTable(table.names, values)})


@pytest.mark.parametrize("signal", ["joint_position", "joint_torque", "motor_position", "motor_current"])
def test_what_a_missing_column_would_tell_is_not_judged_and_the_rest_is_as_before(log, whole, signal: str) -> None:
    found = compare(without(log, signal), nominal_model(), {})
    gone = [c for c in whole.channels if c.name not in {other.name for other in found.channels}]
    assert any(c.name == f"motor_current/{JOINT}" for c in gone)
    drives = [c for c in gone if c.name.startswith(("motor", "joint_torque"))]
    assert all(c.name.endswith(JOINT) for c in drives) and len(drives) == (1 if signal == "motor_current" else 3)
    assert found.worst.over_noise <= 1.05 * whole.worst.over_noise
    assert (f"in the log: {JOINT}." in found.in_words()) == (signal != "motor_current")
    assert ("Only the drives" in found.in_words()) == signal.startswith("joint")


def test_a_missing_velocity_is_that_of_the_position(log: Log) -> None:
    k, less = log.joint_names.index(JOINT), without(log, "joint_velocity")
    position = log.joints("joint_position")[:, k]
    of_position = pytest.approx(np.gradient(position, log.sample_period), rel=1e-5, abs=1e-5)
    assert drive_log(less).joint_velocity[:, k] == of_position and body_log(less).u[:, 6 + k] == of_position
    others = np.arange(12) != k
    assert (drive_log(less).joint_velocity[:, others] == drive_log(log).joint_velocity[:, others]).all()
    assert channels_logged(less).all()


def test_the_velocity_of_a_motor_that_was_not_logged_is_that_of_its_own_position(log: Log) -> None:
    assert "motor_velocity" not in log.signals
    gradient = np.gradient(log.joints("motor_position"), log.sample_period, axis=0)
    np.testing.assert_allclose(drive_log(log).motor_velocity, gradient, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("signal", ["joint_position", "joint_torque", "motor_position", "motor_current"])
def test_single_missing_samples_are_held_and_the_joint_stays_judged(log: Log, signal: str) -> None:
    k, less = log.joint_names.index(JOINT), with_rows(log, signal, [0, 1, 50])
    assert channels_logged(less).all()
    held = log.joints(signal)[:, k].copy()
    held[[0, 1, 50]] = held[[2, 2, 49]]
    assert getattr(drive_log(less), signal)[:, k] == pytest.approx(held, rel=1e-6)


def test_a_row_without_a_torque_is_commanded_by_position_and_without_both_the_joint_stays_where_it_is(log: Log) -> None:
    k, less = log.joint_names.index(JOINT), with_rows(log, "command_torque", slice(100, 200))
    drives = drive_log(with_rows(less, "command_position", slice(100, 150), 0.3))
    assert np.flatnonzero(drives.position_mode[:, k]).tolist() == list(range(100, 200))
    assert (drives.command_position[100:150, k] == np.float32(0.3)).all()
    assert (drives.command_position[150:200, k] == drives.joint_position[150:200, k]).all()


def test_a_joint_that_is_not_judged_rests_and_one_without_its_current_does_not(log: Log) -> None:
    here = np.arange(12) == log.joint_names.index(JOINT)
    for part, whole in zip(drive_log(without(log, "motor_position")), drive_log(log), strict=True):
        assert not part[:, here].any() and (part[:, ~here] == whole[:, ~here]).all()
    for part, whole in zip(drive_log(without(log, "motor_current"))[:-1], drive_log(log)[:-1], strict=True):
        assert (part == whole).all()


def test_an_axis_of_the_torsos_velocity_that_was_not_logged_is_that_of_its_position(log: Log) -> None:
    less = body_log(without(log, "base_linear_velocity", "y"))
    of_position = np.gradient(log.vector("base_position")[:, 1], log.sample_period)
    assert less.u[:, 1] == pytest.approx(of_position, rel=1e-5, abs=1e-5)
    assert (less.u[:, [0, 2]] == body_log(log).u[:, [0, 2]]).all()


@pytest.mark.parametrize("gone", [LEGS, ("RF",)])
def test_bodies_on_the_ground_are_not_judged_where_nobody_says_which_feet_stand(log: Log, gone: tuple) -> None:
    less = log
    for leg in gone:
        less = without(less, "foot_contact", leg)
    assert shows_bodies(log) and not shows_bodies(less)
    assert "foot_contact" in compare(less, nominal_model(), {}).in_words()


def test_a_velocity_that_was_not_logged_has_the_noise_of_its_positions_differences(log: Log) -> None:
    signals = {name: table for name, table in log.signals.items() if name != "joint_velocity"}
    less = replace(log.on_time(log.time, log.sample_period, signals), noise_std={"joint_position": 2e-4})
    drawn = np.random.default_rng(0).normal(0.0, 2e-4, 20_000)
    assert noise_of(less)["joint_velocity"] == pytest.approx(np.gradient(drawn, log.sample_period).std(), rel=0.03)


def test_a_joint_that_was_never_commanded_is_not_judged(log: Log) -> None:
    dark = log
    for signal in {"command_torque", "command_position"} & set(log.signals):
        dark = without(dark, signal)
    told = channels_logged(dark)
    assert not told[log.joint_names.index(JOINT)].any() and told.sum() == 33


def test_what_no_log_shows_is_not_learned(log: Log) -> None:
    """No foot slides in a squat on dry ground."""
    wanted = [("ground_friction", "feet")]
    with pytest.raises(UserError, match="nothing logged tells of ground_friction at feet; record a motion"):
        learn([log], nominal_model(), {"ground_friction": LIBRARY["ground_friction"]}, wanted)


def test_of_several_effects_the_one_that_no_log_shows_is_named_and_some_numbers_of_one_may_stay_untold() -> None:
    load = Placed("payload", "torso", {"mass": 1.0, "x": 0.0, "y": 0.0, "z": 0.1})
    effects = (load, Placed("coulomb_friction", "LF_HFE", {"torque": 0.01}))
    logs = [SimpleNamespace(name="squat"), SimpleNamespace(name="air")]

    def refuse(*told: float) -> None:
        _refuse_untold(logs, Refitted(effects, np.zeros(0), np.zeros(0), (), (), np.diag(told)))

    refuse(1.0, 0.0, 0.0, 0.0, 1.0)
    with pytest.raises(UserError, match="squat and air: nothing logged tells of coulomb_friction at LF_HFE"):
        refuse(1.0, 1.0, 1.0, 1.0, 0.0)
    with pytest.raises(UserError, match="nothing logged tells of payload at torso"):
        refuse(0.0, 0.0, 0.0, 0.0, 1.0)
