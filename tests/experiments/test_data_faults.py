"""Faults put into sound logs are named for what they are; sound logs, hidden effects and all, raise none."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.independent_plant.cases import draw_effect
from experiments.independent_plant.library import FAMILIES, Effect
from experiments.independent_plant.logs import columns, robot_info, write_log
from experiments.independent_plant.runner import Case, record
from experiments.independent_plant.strength import reachable
from experiments.measurement.answer import answer_of
from experiments.measurement.checks.check import check
from experiments.measurement.checks.copied_columns import copied_columns
from experiments.measurement.checks.faults import Fault, listed
from experiments.measurement.intake import LogFault
from experiments.measurement.logs.log import Log, SignalTable
from experiments.measurement.logs.log_info import LogInfo
from experiments.measurement.logs.log_reader import make_log, read_log
from mjx_starleth.numbers import load_numbers

DATA = Path(__file__).parents[1] / "data"
NUMBERS = load_numbers().model_dump(mode="json")
SENSORS = ("joint_position", "joint_velocity", "motor_position", "motor_velocity", "joint_torque", "motor_current")
ALL = (*SENSORS, "command_torque", "command_position")
DEGREES = 180.0 / np.pi

Change = Callable[[np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def air() -> Log:
    return read_log(DATA / "air_reference_1500ms.csv.gz")


@pytest.fixture(scope="module")
def squat() -> Log:
    return read_log(DATA / "squat_reference_1500ms.csv.gz")


def with_columns(log: Log, signals: tuple[str, ...], names: tuple[str, ...], change: Change) -> Log:
    """The log with `change` done to the columns (T, k) of some signals."""
    tables = dict(log.signals)
    for signal in set(signals) & set(tables):
        table = tables[signal]
        values = table.values.copy()
        chosen = [table.names.index(name) for name in names or table.names]
        values[:, chosen] = change(values[:, chosen])
        tables[signal] = SignalTable(table.names, values)
    return replace(log, signals=tables)


def with_rows(log: Log, rows: np.ndarray, renumbered: bool) -> Log:
    """Only these rows, under their own time or as if nothing had happened."""
    time = log.time[: len(rows)] if renumbered else log.time[rows]
    tables = {signal: SignalTable(table.names, table.values[rows]) for signal, table in log.signals.items()}
    return log.on_time(time, log.sample_period, tables)


def late(samples: int) -> Change:
    """Early, where negative; held at the end."""
    return lambda values: values[np.clip(np.arange(len(values)) - samples, 0, len(values) - 1)]


def frozen(values: np.ndarray) -> np.ndarray:
    return np.repeat(values[:1], len(values), axis=0)


def hanging(start: int, stop: int) -> Change:
    return lambda values: np.concatenate(
        [values[:start], np.repeat(values[start : start + 1], stop - start, 0), values[stop:]]
    )


def shuffled(values: np.ndarray) -> np.ndarray:
    """The same values in no order: what a sensor reads that is not connected."""
    return np.random.default_rng(3).permutation(values)


def leaping(row: int, by: float) -> Change:
    return lambda values: values + by * (np.arange(len(values)) == row)[:, None]


def test_sound_logs_have_no_fault(air: Log, squat: Log) -> None:
    assert check(air, NUMBERS) == [] == check(squat, NUMBERS)


def swapped(values: np.ndarray) -> np.ndarray:
    return values[:, ::-1]


@pytest.mark.parametrize(
    ("signals", "names", "change", "fault", "named"),
    [
        (("joint_torque",), ("LF_HAA", "RF_HFE"), swapped, "swapped_joints", "joint_torque of LF_HAA and RF_HFE"),
        (SENSORS, ("LH_HFE", "RH_HFE"), swapped, "swapped_joints", "LH_HFE and RH_HFE"),
        (ALL, ("LF_HFE", "LF_KFE"), swapped, "swapped_joints", "LF_HFE and LF_KFE"),
        (("joint_position",), ("RH_HFE",), np.negative, "sign", "joint_position of RH_HFE"),
        (("joint_torque",), (), np.negative, "sign", "joint_torque of all joints"),
        (("joint_position",), (), lambda x: DEGREES * x, "unit", "in deg, not in rad"),
        (("joint_torque",), ("LF_HFE",), lambda x: 1e3 * x, "unit", "joint_torque of LF_HFE"),
        (("motor_current",), (), lambda x: 1e3 * x, "unit", "in mA, not in A"),
        (("joint_torque",), (), late(12), "time_shift", "late against the other signals"),
        (("joint_position", "joint_velocity"), ("RF_HFE",), late(10), "time_shift", "of RF_HFE"),
        (("joint_position", "joint_velocity"), ("RF_HFE",), frozen, "joint_never_moves", "RF_HFE"),
        (("motor_current",), ("RH_KFE",), frozen, "dead_sensor", "motor_current of RH_KFE"),
        (("joint_velocity",), (), lambda x: np.clip(x, -0.5, 0.5), "clipped_sensor", "joint_velocity"),
        (("joint_velocity",), ("RF_KFE",), hanging(200, 260), "stuck_sensor", "joint_velocity of RF_KFE"),
        (("joint_torque",), ("LF_HFE",), hanging(300, 600), "stuck_sensor", "joint_torque of LF_HFE"),
        (("joint_position",), (), lambda x: x / DEGREES, "unit", "joint_position of all joints"),
        (("motor_position",), (), lambda x: x / (2.0 * np.pi), "unit", "in rev, not in rad"),
        (("joint_torque",), (), lambda x: 0.01 * x, "unit", "0.01 times what the other signals say"),
        (("joint_velocity",), ("RF_KFE",), shuffled, "unrelated", "joint_velocity of RF_KFE agrees with no other"),
        (("joint_torque",), ("LH_HFE",), shuffled, "unrelated", "joint_torque of LH_HFE agrees with no other"),
        (("motor_position",), ("LH_HFE",), leaping(250, 0.1), "spike", "in 1 place, first at 0.625 s"),
        (("joint_torque",), ("LF_HAA", "RF_HFE"), lambda x: x[:, [0, 0]], "copied_column", "joint_torque/RF_HFE hold"),
    ],
)
def test_a_fault_of_columns_is_named(air: Log, signals, names, change, fault: str, named: str) -> None:
    found = check(with_columns(air, signals, names, change), NUMBERS)
    assert [f.fault for f in found] == [fault], found
    assert named in found[0].message


@pytest.mark.parametrize(("fourth", "fault"), [(0.1, False), (1.0, True)])
def test_hips_that_are_held_may_move_a_little(squat: Log, fourth: float, fault: bool) -> None:
    """Of the hips, which move by 64 mrad, three by 4 mrad: at rest as the fourth is, or fast in their bearings."""

    def scaled(share: float) -> Change:
        return lambda values: values.mean(0) + share * (values - values.mean(0))

    log = with_columns(squat, SENSORS, ("LF_HAA", "RF_HAA", "LH_HAA"), scaled(4.0 / 64.0))
    found = check(with_columns(log, SENSORS, ("RH_HAA",), scaled(fourth)), NUMBERS)
    assert ("joint_never_moves" in {f.fault for f in found}) == fault, found


def test_missing_values_are_a_fault_in_a_block_and_bridged_one_by_one(air: Log) -> None:
    def holes(rows: slice) -> Log:
        def dig(values: np.ndarray) -> np.ndarray:
            values[rows] = np.nan
            return values

        return with_columns(air, ("joint_torque",), ("LH_KFE",), dig)

    (fault,) = check(holes(slice(100, 140)), NUMBERS)
    assert (fault.fault, fault.where) == ("no_value", "LH_KFE") and "40 of 600 rows" in fault.message
    assert check(holes(slice(100, 101)), NUMBERS) == []


@pytest.mark.parametrize("renumbered", [False, True])
def test_dropped_and_repeated_samples_are_found_whatever_the_time_says(air: Log, renumbered: bool) -> None:
    every = np.arange(air.rows)
    (lost,) = check(with_rows(air, np.delete(every, slice(300, 320)), renumbered), NUMBERS)
    assert lost.fault == "dropped_samples"
    twice = np.sort(np.concatenate([every, [200, 201, 202, 400, 500]]))[: air.rows]
    (again,) = check(with_rows(air, twice, renumbered), NUMBERS)
    assert again.fault == "repeated_samples"


def test_legs_that_move_alike_without_noise_are_no_copies(air: Log) -> None:
    tables = {
        signal: SignalTable(table.names, table.values[:, np.arange(12) % 3]) for signal, table in air.signals.items()
    }
    alike = replace(air, signals=tables)
    assert list(copied_columns(replace(alike, noise_std={}))) == []
    assert len(list(copied_columns(alike))) == 1


def test_time_in_another_unit_or_running_backwards_is_named(air: Log) -> None:
    (unit,) = check(air.on_time(1e3 * air.time, air.sample_period, air.signals), NUMBERS)
    assert unit.fault == "unit" and "in ms" in unit.message
    back = air.time.copy()
    back[[50, 51]] = back[[51, 50]]
    (order,) = check(air.on_time(back, air.sample_period, air.signals), NUMBERS)
    assert order.fault == "time" and "backwards" in order.message


def test_rows_left_out_or_a_period_in_another_unit_show_in_velocities_against_positions(slow: Log) -> None:
    (thinned,) = check(with_rows(slow, np.arange(0, slow.rows, 2), renumbered=True), NUMBERS)
    assert thinned.fault == "time" and "0.005 s apart, not 0.0025 s" in thinned.message
    (unit,) = check(slow.on_time(1e3 * slow.time, 1e3 * slow.sample_period, slow.signals), NUMBERS)
    assert unit.fault == "time" and "0.0025 s apart, not 2.5 s" in unit.message


def test_the_torso_s_sensors_are_checked_too(slow: Log) -> None:
    for changed, fault, named in (
        (
            with_columns(slow, ("base_acceleration",), ("z",), hanging(600, 800)),
            "stuck_sensor",
            "base_acceleration of z",
        ),
        (with_columns(slow, ("base_linear_velocity",), (), lambda x: 3.6 * x), "unit", "in km/h, not in m/s"),
        (replace(slow, experiment="fixed_base"), "experiment", "base_position moves"),
    ):
        (found,) = check(changed, NUMBERS)
        assert found.fault == fault and named in found.message, found


def test_a_noise_std_that_the_samples_contradict_is_named(air: Log) -> None:
    for factor, shown in ((1e3, "its samples scatter by"), (1e-6, "it is logged in steps of")):
        claimed = dict(air.noise_std) | {"joint_position": factor * air.noise_std["joint_position"]}
        (found,) = check(replace(air, noise_std=claimed), NUMBERS)
        assert (found.fault, found.where) == ("noise_std", "joint_position") and shown in found.message


def test_faults_of_the_joints_are_found_on_the_ground_too(squat: Log) -> None:
    for signals, names, change, fault in (
        (("joint_torque",), ("LF_KFE", "RF_KFE"), np.negative, "sign"),
        (("motor_position",), ("LF_HFE", "LH_HFE"), swapped, "swapped_joints"),
        (SENSORS, ("LF_KFE", "RF_KFE"), swapped, "swapped_joints"),
        (("motor_current",), ("LF_HAA",), np.negative, "sign"),
    ):
        found = check(with_columns(squat, signals, names, change), NUMBERS)
        assert {f.fault for f in found} == {fault}, found


# --- what is no fault --------------------------------------------------------------------------------------------


def as_log(case: Case, recording, place: int) -> Log:
    info = LogInfo.model_validate(robot_info(case.platform, case.sensors, list(recording.signals)))
    table = columns(recording, place)
    return make_log({"time": np.arange(len(table["joint_position/LF_HAA"])) * case.period, **table}, info)


@pytest.fixture(scope="module")
def slow() -> Log:
    """A squat by torque with every signal."""
    case = Case("squat", seed=7, duration=2.0)
    return as_log(case, record([case]), 0)


@pytest.mark.parametrize(
    ("signal", "names", "by"), [("motor_current", (), 10), ("motor_current", ("LH_KFE",), 12), ("joint_torque", (), 12)]
)
def test_a_shift_in_a_slow_motion_shows_in_the_loops_answer_to_the_sensors_noise(slow: Log, signal, names, by) -> None:
    (found,) = check(with_columns(slow, (signal,), names, late(by)), NUMBERS)
    assert found.fault == "time_shift" and signal in found.message and f" {by} samples" in found.message, found


def test_a_single_lost_row_shows_in_all_motors_though_time_was_renumbered(slow: Log) -> None:
    for row in range(100, 701, 100):
        (lost,) = check(with_rows(slow, np.delete(np.arange(slow.rows), row), renumbered=True), NUMBERS)
        assert lost.fault == "dropped_samples" and f"in 1 place, first at {slow.time[row]:g} s" in lost.message


def test_contacts_the_wrong_way_round_are_told_from_flight(slow: Log) -> None:
    assert check(slow, NUMBERS) == []
    (found,) = check(with_columns(slow, ("foot_contact",), (), lambda x: 1.0 - x), NUMBERS)
    assert found.fault == "contact", found


SUSPECTS = (  # effects that look most like a wrong gain, sign, time or a stuck joint
    "coulomb_friction",
    "joint_coulomb_drag",
    "backlash",
    "spring_stiffness",
    "spring_damping",
    "spring_hysteresis",
    "command_delay",
    "sensor_delay",
    "joint_encoder_offset",
    "torque_sensor_gain",
)


def assert_no_alarm(motion: str, effects: list[Effect], duration: float) -> None:
    cases = [Case(motion, "rich", (effect,), seed, duration) for seed, effect in enumerate(effects)]
    recording = record(cases)
    for place, case in enumerate(cases):
        assert recording.fallen[place] or check(as_log(case, recording, place), NUMBERS) == [], case.effects


def test_an_effect_is_not_taken_for_a_fault() -> None:
    rng = np.random.default_rng(0)
    assert_no_alarm("air", [draw_effect(name, "air", 0.5, rng) for name in SUSPECTS], 1.0)


def test_sensors_that_are_all_late_are_no_shift_of_the_torque_that_mends_a_little() -> None:
    case = Case("squat", "rich", (Effect("sensor_delay", "all", {"delay": 0.0139}),), 53, 2.0)
    assert check(as_log(case, record([case]), 0), NUMBERS) == []


def test_motors_that_chatter_while_their_joints_rest_are_no_fault() -> None:
    """A spring with much damping under a slow squat: the torque loops rock the motors from row to row."""
    case = Case("squat", "poor", (Effect("spring_damping", "all", {"added": 1.27}),), 17, 3.0)
    log = as_log(case, record([case]), 0)
    speed = log.joints("motor_velocity")
    assert (np.sign(speed[1:]) != np.sign(speed[:-1])).mean() > 0.5  # they do
    assert check(log, NUMBERS) == []


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["air", "air_torque", "squat", "hops"])
def test_no_effect_at_all_is_taken_for_a_fault(motion: str) -> None:
    """Every effect, in the library or not, weak and as strong as the robot stands it."""
    rng = np.random.default_rng(0)
    names = [name for name in FAMILIES if reachable(motion, name)]
    effects = [draw_effect(name, motion, level, rng) for name in names for level in (0.05, 0.5)]
    if motion == "squat":
        effects.append(Effect("sensor_delay", "torso", {"delay": 4e-3}))
    assert_no_alarm(motion, effects, 2.0)


def test_what_a_fault_is_in_is_called_what_it_is(air: Log) -> None:
    legs, axes = ("LF", "RF", "LH", "RH"), ("x", "y", "z")
    assert listed(legs, legs) == "all legs" and listed(axes, axes) == "all axes"
    assert listed(tuple("wxyz"), tuple("wxyz")) == "all components"
    assert listed(air.joint_names, air.joint_names) == "all joints"
    # three joints that were logged and have holes are neither axes nor all of the robot's
    leg = air.joint_names[:3]
    values = np.where(np.arange(air.rows)[:, None] < 50, np.nan, air.joints("joint_torque")[:, :3])
    (fault,) = check(replace(air, signals={**air.signals, "joint_torque": SignalTable(leg, values)}), NUMBERS)
    assert (fault.fault, fault.where) == ("no_value", "LF_HAA, LF_HFE and LF_KFE")


def test_the_answer_to_a_faulty_log_has_the_keys_of_every_answer() -> None:
    answer = LogFault(Path("log.csv"), [Fault("sign", "LF_HAA", "turn it.")]).answer()
    assert set(answer) == {"faults", *answer_of("explained", "text", "next")}
    assert answer["held_out_rms"] is None and answer["unexplained_fraction"] == 1.0
    for key in ("effects", "tied_with", "ranking", "refuted", "unsteady", "rest_goes_with"):
        assert answer[key] == []


# --- the commands ------------------------------------------------------------------------------------------------


def written(path: Path, log: Log) -> Path:
    table = {f"{s}/{n}": t.column(n) for s, t in log.signals.items() for n in t.names}
    write_log(path, table, json.loads((DATA / "air_reference_1500ms.json").read_text()), log.sample_period)
    return Path(f"{path}.csv.gz")


def starleth(*words: object) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", "from experiments.cli.main import main\nmain()", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True)


def test_the_commands_name_the_fault_in_one_sentence(air: Log, tmp_path: Path) -> None:
    path = written(tmp_path / "bad", with_columns(air, ("joint_torque",), ("LF_HAA", "RF_HFE"), swapped))
    compared = starleth("compare", path)
    assert compared.returncode == 2 and "LF_HAA and RF_HFE are swapped" in compared.stderr
    assert "Traceback" not in compared.stderr and compared.stderr.count("\n") == 1
    assert starleth("diagnose", path, "--output", tmp_path / "out").returncode == 0
    answer = json.loads((tmp_path / "out/diagnosis.json").read_text())
    assert answer["verdict"] == "data_fault" and answer["effects"] == []
    assert answer["faults"][0]["fault"] == "swapped_joints" and "LF_HAA" in answer["faults"][0]["where"]
    assert "LF_HAA and RF_HFE are swapped" in (tmp_path / "out/report.html").read_text()
