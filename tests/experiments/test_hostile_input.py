"""Hostile input to every reader: it is read or refused in one sentence, and what it claims costs no memory."""

import io
import json
import os
import resource
import struct
import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.errors import UserError
from experiments.fuzz.good_files import good_csv, good_info
from experiments.fuzz.mutations import bomb
from experiments.fuzz.readers import READERS
from experiments.fuzz.run import problem
from experiments.measurement.logs.binary_tables import read_npz
from experiments.measurement.logs.csv_table import read_csv
from experiments.measurement.logs.log_reader import read_log
from experiments.measurement.logs.table_limits import Limits
from experiments.sweep.definition import parse_sweep

MANY = int(os.environ.get("STARLETH_FUZZ", "100000"))
PER_READER = 12
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=12), inner, max_size=4),
    max_leaves=12,
)
SWEEP_KEYS = st.sampled_from(["tasks", "models", "seeds", "drive", "generations", "perturbations", "about"])


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_hostile_files_are_read_or_refused_in_one_sentence(reader, tmp_path):
    for number in range(-PER_READER, 0):  # not the numbers that `python -m experiments.fuzz` tries
        found = problem(reader, number, tmp_path)
        assert not found, f"{reader.name} {number}: {found}"


def test_a_reader_that_lets_an_exception_through_is_found(tmp_path, monkeypatch):
    reader = next(reader for reader in READERS if reader.name == "log npz")
    monkeypatch.setattr("experiments.measurement.logs.log_reader.read_npz", lambda *_: 1 / 0)
    assert "ZeroDivisionError" in problem(reader, 0, tmp_path)


@pytest.mark.slow
def test_a_hundred_thousand_hostile_files(capfd):
    done = subprocess.run(
        [sys.executable, "-m", "experiments.fuzz", "--count", str(MANY)], capture_output=True, text=True
    )
    with capfd.disabled():
        print(done.stdout)
    assert done.returncode == 0, done.stdout
    assert json.loads(done.stdout.splitlines()[-1])["inputs"] >= 0.99 * MANY


@given(st.text())
@settings(deadline=None)
def test_an_error_is_one_printable_line_whatever_it_quotes(name):
    told = str(UserError(f"No task '{name}'."))
    assert told.isprintable() and told.startswith("No task '") and told.endswith("'.")


@given(st.dictionaries(SWEEP_KEYS, JSON | st.lists(st.text(max_size=30), max_size=3), max_size=5))
@settings(deadline=None, max_examples=150)
def test_any_sweep_stays_in_its_folder(content):
    try:
        sweep = parse_sweep({"tasks": ["a"]} | content, "sweep.json")
    except UserError as error:
        assert str(error).isprintable() and str(error).endswith((".", "…"))
        return
    names = [member.name for member in sweep.members()]
    assert len(set(names)) == len(names)
    for member in sweep.members():
        assert (Path("/sweep") / member.name).resolve().parent == Path("/sweep")
        first, *options = sweep.tune_arguments(member)
        assert not first.startswith("-")
        assert all(word.startswith(("--seed=", "--model=", "--drive=", "--gen", "--pop", "--pert")) for word in options)


@given(
    st.lists(st.lists(st.floats(width=64) | st.none(), min_size=3, max_size=3), max_size=30),
    st.sampled_from("\n \r\n \r".split(" ")),
)
@settings(deadline=None, max_examples=100)
def test_any_table_survives_csv(rows, newline):
    text = newline.join(["time,a,b", *(",".join("" if x is None else repr(x) for x in row) for row in rows), ""])
    found = read_csv(text.encode(), "log", False)
    expected = np.array([[np.nan if x is None else x for x in row] for row in rows], float).reshape(-1, 3)
    for column, name in enumerate(("time", "a", "b")):
        assert np.array_equal(found[name], expected[:, column], equal_nan=True)


@pytest.mark.parametrize("unit", [b"0", b"1,", b"\n", b"time,a\n1,2\n"])
def test_a_gzip_bomb_is_refused_with_bounded_memory(unit):
    small = Limits(unpacked_bytes=1 << 26, cells=1_000_000)
    data = bomb(b"time,a\n" + unit * 100, 1 << 28)
    tracemalloc.start()
    try:
        with pytest.raises(UserError):
            read_csv(data, "bomb", True, limits=small)
        assert tracemalloc.get_traced_memory()[1] < 1 << 27
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("shape", ["(10**15,)", "(-1,)", "(2**40, 2**40)", "(9" + "9" * 30 + ",)"])
def test_an_array_header_that_claims_too_much_is_refused_before_anything_is_allocated(shape):
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".replace("10**15", str(10**15)).encode()
    header = header.replace(b"2**40", str(2**40).encode())
    npy = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(80)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("time.npy", npy)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UserError):
        read_npz(buffer.getvalue(), "log")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1 << 16  # KB


def test_a_pickle_is_refused_and_not_run(tmp_path):
    class Evil:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    buffer = io.BytesIO()
    np.savez(buffer, time=np.array([Evil()], object))
    (tmp_path / "log.npz").write_bytes(buffer.getvalue())
    (tmp_path / "log.json").write_bytes(good_info())
    with pytest.raises(UserError, match="no array of numbers"):
        read_log(tmp_path / "log.npz")
    assert not (tmp_path / "ran").exists()


def test_rows_of_a_csv_after_blank_lines_are_read():
    text = good_csv().replace(b"\n", b"\n\n\n", 1)
    assert read_csv(text, "log", False)["time"].size == 20
