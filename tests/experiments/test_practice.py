"""A log to practise on hides what its user asked for, and says in one sentence what cannot be hidden."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from controller_jax.geometry import geometry_from_numbers
from experiments.errors import UserError
from experiments.independent_plant.library import Effect
from experiments.independent_plant.practice import parse_hidden, practise
from experiments.measurement import read_log
from experiments.measurement.excitation import excitations
from experiments.measurement.next_experiment import write_commands
from experiments.model import nominal_model
from mjx_starleth.names import JOINT_NAMES

PERIOD = 2.5e-3
LIMITS = np.asarray(geometry_from_numbers(nominal_model().numbers.model_dump(mode="json")).position_limits, float)


def test_an_effect_is_told_as_learn_is() -> None:
    told = parse_hidden("backlash@LH_KFE half_width=0.02")
    assert told == Effect("backlash", "LH_KFE", {"half_width": 0.02})
    assert parse_hidden("payload mass=2 x=0.1").where == "torso"
    assert parse_hidden("load_friction coefficient=0.1").where == "all"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no effect"),
        ("grease@all amount=1", "no effect"),
        ("backlash@LH_KNEE half_width=0.02", "no joint"),
        ("payload@LH mass=2", "acts on torso"),
        ("backlash half=0.02", "no parameter"),
        ("backlash half_width=wide", "parameter=number"),
        ("backlash half_width=nan", "no finite number"),
        ("payload mass=inf", "no finite number"),
        ("payload x=0.1", "How much payload"),
    ],
)
def test_what_cannot_be_hidden_is_told(text: str, says: str) -> None:
    with pytest.raises(UserError, match=says):
        parse_hidden(text)


def test_a_log_is_that_of_the_motion_with_what_was_hidden(tmp_path: Path) -> None:
    for name, hidden in (("plain", []), ("play", [parse_hidden("backlash@LH_KFE half_width=0.02")])):
        assert not practise("air", hidden, tmp_path / name, duration=2.0, seed=3)
    plain, play = (read_log(tmp_path / f"{name}.csv.gz") for name in ("plain", "play"))
    apart = np.abs(plain.signals["joint_torque"].values - play.signals["joint_torque"].values).std(0)
    assert plain.rows == 800 and JOINT_NAMES[np.argmax(apart)] == "LH_KFE"
    assert not any("backlash" in path.read_text() for path in tmp_path.glob("*.json"))


def test_a_simulation_that_breaks_down_leaves_no_log(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)  # where MuJoCo writes its warning
    with pytest.raises(UserError, match="breaks down"):
        practise("air", [parse_hidden("spring_stiffness change=-3")], tmp_path / "log", duration=2.0)
    assert not list(tmp_path.glob("log*"))


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("time,command_torque/LF_HAA\n0,0\n1e9,0\n", "no more than 600 s"),
        ("time,command_torque/LF_HAA\n0,0\n1,inf\n", "infinite"),
        ("time,command_torque/LF_HAA\n1,0\n0,0\n", "increase"),
        ("time,command_torque/LF_HAA\n0,0\n1\n", "cannot be read"),
        ("time,speed\n0,0\n1,0\n", "commands no joint"),
        ("speed\n0\n", "a column 'time'"),
    ],
)
def test_a_command_file_that_cannot_be_played_is_refused(tmp_path: Path, table: str, says: str) -> None:
    (tmp_path / "next.csv").write_text(table)
    with pytest.raises(UserError, match=says):
        practise(str(tmp_path / "next.csv"), [], tmp_path / "log")
    assert not list(tmp_path.glob("log*"))


def test_a_command_file_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    packed = gzip.compress(b"time,command_torque/LF_HAA\n" + b"".join(b"%d,0.5\n" % k for k in range(100)))
    (tmp_path / "next.csv.gz").write_bytes(packed[: len(packed) // 2])
    with pytest.raises(UserError, match="cannot be read"):
        practise(str(tmp_path / "next.csv.gz"), [], tmp_path / "log")


def test_the_next_experiment_can_be_played(tmp_path: Path) -> None:
    rest = np.clip(LIMITS.mean(1), LIMITS[:, 0] + 0.3, LIMITS[:, 1] - 0.3)
    asked = excitations(LIMITS, rest, PERIOD)[0]
    short = asked._replace(position=asked.position[:800])
    write_commands(tmp_path / "next.csv", short, JOINT_NAMES, PERIOD)
    assert not practise(str(tmp_path / "next.csv"), [], tmp_path / "log")
    log = read_log(tmp_path / "log.csv.gz")
    assert log.experiment == "fixed_base" and log.rows == 800
    np.testing.assert_allclose(log.signals["command_position"].values, short.position, atol=1e-6)
    with pytest.raises(UserError, match="neither a motion"):
        practise("jump", [], tmp_path / "log")
