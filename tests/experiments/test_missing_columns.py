"""Logs that lack a joint's column: what they do not tell is not judged, and never taken for zeros."""

from pathlib import Path

import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.errors import UserError
from experiments.measurement.compare import Comparison, compare
from experiments.measurement.evidence.body_replay import body_log
from experiments.measurement.evidence.drive_log import channels_logged, drive_log
from experiments.measurement.learn import learn
from experiments.measurement.logs.log import Log, SignalTable
from experiments.measurement.logs.log_reader import read_log
from experiments.model import nominal_model

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
