"""One experiment in every file format, other names and units, other time axes; delays to a part of a sample."""

import gzip
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from experiments.errors import UserError
from experiments.measurement.checks.delays import estimate_delay, signal_delays
from experiments.measurement.intake import read_checked
from experiments.measurement.logs.log import Log, SignalTable
from experiments.measurement.logs.log_reader import read_log
from experiments.measurement.logs.resample import resample
from experiments.measurement.logs.units import to_si
from experiments.model import nominal_model
from mjx_starleth.numbers import load_numbers

DATA = Path(__file__).parents[1] / "data"
SOURCE = DATA / "air_reference_1500ms.csv.gz"
PERIOD = 2.5e-3  # s


@pytest.fixture(scope="module")
def log() -> Log:
    return read_log(SOURCE)


def assert_same(one: Log, other: Log) -> None:
    assert set(one.signals) == set(other.signals)
    np.testing.assert_allclose(one.time, other.time, rtol=0, atol=1e-9)
    for signal, table in one.signals.items():
        np.testing.assert_allclose(table.values, other.signals[signal].values, rtol=1e-12, atol=1e-12)


def beside(path: Path, **changes: object) -> Path:
    """Writes the JSON of a log, with some keys changed."""
    info = json.loads((DATA / "air_reference_1500ms.json").read_text())
    path.with_name(path.name.split(".")[0] + ".json").write_text(json.dumps(info | changes))
    return path


def columns_of(log: Log) -> dict[str, np.ndarray]:
    return {"time": log.time} | {f"{s}/{n}": t.column(n) for s, t in log.signals.items() for n in t.names}


def test_every_format_gives_the_same_log(log: Log, tmp_path: Path) -> None:
    beside(tmp_path / "run.csv").write_bytes(gzip.decompress(SOURCE.read_bytes()))
    pq.write_table(pa.table(columns_of(log)), tmp_path / "run.parquet")
    np.savez_compressed(tmp_path / "run.npz", **columns_of(log))
    for ending in ("csv", "parquet", "npz"):
        assert_same(read_log(tmp_path / f"run.{ending}"), log)


def test_other_names_and_units_come_in_by_a_column_map(log: Log, tmp_path: Path) -> None:
    table = columns_of(log)
    renamed = {key: values for key, values in table.items() if not key.startswith("joint_position/")}
    renamed |= {f"q_{n} [deg]": np.degrees(log.column("joint_position", n)) for n in log.joint_names}
    renamed["t_ms"] = 1e3 * renamed.pop("time")
    np.savez_compressed(beside(tmp_path / "run.npz"), **renamed)
    (tmp_path / "map.toml").write_text(
        '[columns]\ntime = { from = "t_ms", unit = "ms" }\n"joint_position/*" = { from = "q_* [deg]", unit = "deg" }\n'
    )
    assert_same(read_checked(tmp_path / "run.npz", tmp_path / "map.toml", nominal_model()), log)


def test_a_column_that_is_not_there_is_told_with_some_that_are(log: Log, tmp_path: Path) -> None:
    np.savez_compressed(beside(tmp_path / "run.npz"), **columns_of(log))
    (tmp_path / "map.toml").write_text('[columns]\ntime = { from = "t_ms" }\n')
    with pytest.raises(UserError, match=r"from 't_ms'.*take it from one of its columns: time, .* and \d+ more\.$"):
        read_checked(tmp_path / "run.npz", tmp_path / "map.toml", nominal_model())


def test_a_log_of_years_is_refused_with_its_name_and_what_to_do(log: Log) -> None:
    years = log.on_time(1e7 * log.time, 1e7 * PERIOD, log.signals)
    with pytest.raises(UserError, match=rf"^{log.name} spans .* correct the unit of its time with a column map"):
        resample(years, PERIOD)


@pytest.mark.parametrize(
    ("number", "unit", "si", "expected"),
    [
        (250.0, "us", "s", 2.5e-4),
        (180.0, "deg", "rad", np.pi),
        (0.5, "rev", "rad", np.pi),
        (60.0, "rpm", "rad/s", 2.0 * np.pi),
        (90.0, "°/s", "rad/s", 0.5 * np.pi),
        (3.6, "km/h", "m/s", 1.0),
        (2.0, "g", "m/s^2", 19.6133),
        (10.0, "kgf cm", "N m", 0.980665),
        (50.0, "N cm", "N m", 0.5),
        (50.0, "Nmm", "N m", 0.05),
        (2.0, "kgf", "N", 19.6133),
        (1500.0, "mA", "A", 1.5),
    ],
)
def test_units_are_what_they_are_elsewhere(number: float, unit: str, si: str, expected: float) -> None:
    assert number * to_si(unit, si, "a column") == pytest.approx(expected, rel=1e-12)


def smooth(time: np.ndarray, frequency: float) -> np.ndarray:
    return np.sin(2.0 * np.pi * frequency * time)


def with_time(log: Log, time: np.ndarray, period: float) -> Log:
    """A log of known smooth motion and of a command that changes at every tick, sampled at `time`."""
    q = np.stack([smooth(time, 0.5 + 0.1 * joint) for joint in range(12)], axis=1)
    command = np.repeat(np.floor(time / PERIOD + 0.3)[:, None], 12, axis=1)
    names = log.joint_names
    tables = {"joint_position": SignalTable(names, q), "command_position": SignalTable(names, command)}
    return log.on_time(time, period, tables)


@pytest.mark.parametrize("period", [1e-3, 5e-3])
def test_other_rates_and_uneven_stamps_come_onto_the_ticks(log: Log, period: float) -> None:
    rng = np.random.default_rng(0)
    time = period * np.arange(round(2.0 / period)) + 0.1 * period * rng.uniform(-1.0, 1.0, round(2.0 / period))
    even = resample(with_time(log, time, period), PERIOD)
    np.testing.assert_allclose(np.diff(even.time), PERIOD, rtol=1e-9)
    inside = slice(2, -4)
    expected = np.stack([smooth(even.time, 0.5 + 0.1 * joint) for joint in range(12)], axis=1)
    # monotone cubics cut the tops of a 1.6 Hz sine, sampled at 200 Hz, by 1e-3
    np.testing.assert_allclose(even.joints("joint_position")[inside], expected[inside], atol=2e-3)
    if period < PERIOD:  # a held command is taken over, never mixed of two
        command = even.joints("command_position")[inside, 0]
        assert np.all(command == np.floor(command)) and np.all(np.diff(command) >= 0)


def test_late_stamps_do_not_move_commands_to_other_ticks(log: Log) -> None:
    rng = np.random.default_rng(1)
    jitter = np.concatenate([[0.0], 2e-4 * rng.uniform(-1.0, 1.0, log.rows - 1)])
    even = resample(log.on_time(log.time + jitter, PERIOD, log.signals))
    rows = slice(0, even.rows)
    np.testing.assert_array_equal(even.joints("command_position"), log.joints("command_position")[rows])


def test_an_even_log_is_left_alone_and_single_holes_are_filled(log: Log) -> None:
    assert resample(log) is log
    torque = log.signals["joint_torque"]
    values = torque.values.copy()
    values[100, 3] = np.nan
    filled = resample(replace(log, signals=dict(log.signals) | {"joint_torque": SignalTable(torque.names, values)}))
    neighbours = values[[99, 101], 3]
    assert neighbours.min() <= filled.joints("joint_torque")[100, 3] <= neighbours.max()


@pytest.mark.parametrize(("missing", "known"), [(3, True), (4, False)])
def test_what_a_long_gap_held_stays_unknown(log: Log, missing: int, known: bool) -> None:
    torque = log.signals["joint_torque"]
    values = torque.values.copy()
    values[100 : 100 + missing, 3] = np.nan
    holed = resample(replace(log, signals=dict(log.signals) | {"joint_torque": SignalTable(torque.names, values)}))
    found = np.isfinite(holed.joints("joint_torque"))
    assert found[100 : 100 + missing, 3].all() == found[100 : 100 + missing, 3].any() == known
    assert found.sum() == found.size - (0 if known else missing)


def test_a_delay_is_told_to_a_part_of_a_sample(log: Log) -> None:
    time = PERIOD * np.arange(3200)
    rng = np.random.default_rng(2)
    for delay in (-1.3, 0.0, 0.4, 6.7):  # samples

        def course(shift: float) -> np.ndarray:
            return sum(smooth(time - shift, f) for f in (0.7, 1.9, 3.1, 5.3)) + 0.01 * rng.standard_normal(len(time))

        found, std = estimate_delay(course(0.0), course(delay * PERIOD), PERIOD, 20.0)
        assert abs(found - delay * PERIOD) < 0.02 * PERIOD and std < 0.1 * PERIOD, delay
    numbers = load_numbers().model_dump(mode="json")
    between = [one for one in signal_delays(log, numbers) if one.signal == "joint_velocity"]
    assert len(between) == 12 and all(abs(one.samples) < 0.5 for one in between)


def test_a_column_without_any_value_is_read_whatever_parquet_calls_its_type(tmp_path: Path) -> None:
    columns = {"time": pa.array(np.arange(30) * PERIOD), "joint_position/LF_HAA": pa.nulls(30)}
    pq.write_table(pa.table(columns), tmp_path / "log.parquet")
    info = {"robot": "starleth", "experiment": "fixed_base", "sample_period": PERIOD}
    (tmp_path / "log.json").write_text(json.dumps(info))
    assert np.isnan(read_log(tmp_path / "log.parquet").column("joint_position", "LF_HAA")).all()


def test_another_delimiter_is_guessed_in_the_message(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time;joint_position/LF_HAA\n0;0.1\n")
    (tmp_path / "log.json").write_text('{"robot": "starleth", "experiment": "fixed_base", "sample_period": 0.0025}')
    with pytest.raises(UserError, match='delimiter = ";"'):
        read_log(tmp_path / "log.csv")


@pytest.mark.parametrize(
    ("ending", "change", "named"),
    [
        ("csv", lambda text: text.encode("utf-16"), "no text in UTF-8"),
        ("csv", lambda text: gzip.compress(text.encode()), r"is gzipped; .* \.csv\.gz"),
        ("csv.gz", lambda text: text.encode(), r"is not gzipped; .* \.csv"),
        ("csv", lambda text: text.partition("\n")[2].encode(), "has no header line"),
        ("csv", lambda text: b"PK\x03\x04" + text.encode(), "a zip archive or a spreadsheet"),
    ],
)
def test_a_file_of_another_kind_is_named_for_what_it_is(tmp_path: Path, ending: str, change, named: str) -> None:
    text = gzip.decompress(SOURCE.read_bytes()).decode()
    beside(tmp_path / f"run.{ending}").write_bytes(change(text))
    with pytest.raises(UserError, match=named):
        read_log(tmp_path / f"run.{ending}")
