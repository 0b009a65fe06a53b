"""Atomic writes and strict reading, against a real kernel: full disks, permissions, pipes, kills."""

import errno
import json
import os
import resource
import signal
import stat
import subprocess
import sys
import threading
import time

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from experiments.errors import UserError
from experiments.files import (
    MAX_DEPTH,
    TEMPORARY_NAME,
    json_line,
    parse_json,
    read_json,
    write_bytes,
    write_json,
    write_text,
)

LIMIT = 100_000  # bytes; larger than any file made here on purpose


def one_sentence(error: UserError) -> bool:
    text = str(error)
    return "\n" not in text and text.endswith(".") and "Traceback" not in text and len(text) < 600


def test_a_written_file_is_read_back_with_ordinary_permissions(tmp_path):
    path = tmp_path / "größe.json"
    value = {"µ": [1, 2.5, None, True, "ü"], "n": {"x": -0.1}}
    write_json(path, value)
    assert read_json(path, LIMIT) == value
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask
    write_text(path, "[1]")
    assert read_json(path, LIMIT) == [1]
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "a.json"
    write_text(path, "old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))  # the kernel then refuses the write as if it were full
    try:
        with pytest.raises(UserError) as caught:
            write_bytes(path, b"x" * 10_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert one_sentence(caught.value) and "larger" in str(caught.value)
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["a.json"]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_an_error_at_the_last_moment_leaves_the_old_file(tmp_path, monkeypatch, call):
    path = tmp_path / "a.json"
    write_text(path, "old")

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, call, full)
    with pytest.raises(UserError, match="the disk is full") as caught:
        write_text(path, "new")
    assert one_sentence(caught.value)
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["a.json"]


def test_ctrl_c_leaves_no_temporary_file(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_text(tmp_path / "a", "new")
    assert os.listdir(tmp_path) == []


def test_places_where_nothing_can_be_written(tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (
        file / "below",
        tmp_path / "missing" / "a",
        tmp_path,
        pipe,
        "/dev/null",
        tmp_path / "a\0b",
        "x" * 300,
    ):
        with pytest.raises(UserError) as caught:
            write_text(path, "new")
        assert one_sentence(caught.value), path
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode) and stat.S_ISFIFO(pipe.stat().st_mode)


def test_a_folder_without_write_permission(tmp_path):
    tmp_path.chmod(0o555)
    root = os.geteuid() == 0
    if root:  # work without root's powers
        os.seteuid(65534)
    try:
        with pytest.raises(UserError, match="permission denied") as caught:
            write_text(tmp_path / "a", "new")
    finally:
        if root:
            os.seteuid(0)
        tmp_path.chmod(0o755)
    assert one_sentence(caught.value)


def test_reading_what_is_no_file_or_too_large_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").write_text("[" + "1," * LIMIT + "1]")
    for name in ("pipe", "large", "missing", "."):
        with pytest.raises(UserError) as caught:
            read_json(tmp_path / name, LIMIT)
        assert one_sentence(caught.value), name
    with pytest.raises(UserError, match="not a file"):
        read_json("/dev/zero", LIMIT)


REFUSED = {
    "": "not valid JSON",
    '{"a": 1': "not valid JSON",
    '{"a": NaN}': "NaN",
    "[Infinity]": "Infinity",
    "[-Infinity]": "Infinity",
    "[1e999]": "too large",
    "[" + "9" * 5000 + "]": "integer of 5000 digits",
    '{"a": 1, "b": {"c": 1, "c": 2}}': "key 'c' twice",
    '{"\\n": 1, "\\n": 2}': "twice",
    '["\\ud800"]': "surrogate",
    '{"\\udfff": 1}': "surrogate",
    "[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1): "nested",
    "[" * 50_000: "nested",
    '{"a":' * 50_000: "nested",
    "\ufeff[]": "not valid JSON",
}


@pytest.mark.parametrize("text", REFUSED, ids=lambda text: repr(text[:12]))
def test_refused_json(text):
    with pytest.raises(UserError, match=REFUSED[text]) as caught:
        parse_json(text.encode(), "file.json")
    assert one_sentence(caught.value)


def test_text_that_is_not_utf8():
    with pytest.raises(UserError, match="UTF-8"):
        parse_json(b'{"a": "\xff"}', "file.json")


def test_the_deepest_allowed_nesting_is_read():
    value = parse_json(("[" * MAX_DEPTH + "]" * MAX_DEPTH).encode(), "file.json")
    for _ in range(MAX_DEPTH - 1):
        (value,) = value
    assert value == []


JSON_VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(exclude_categories=("Cs",))),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
    max_leaves=20,
)  # fmt: skip


@given(JSON_VALUES)
@settings(deadline=None)
def test_any_json_value_survives(value):
    assert parse_json(json.dumps(value).encode(), "file.json") == value


@given(st.binary(max_size=400) | st.text(alphabet='[]{}",:0123456789eE+-.NaInfity\\ud8 ', max_size=80).map(str.encode))
@example(b"[-]")
@settings(max_examples=500, deadline=None)
def test_any_bytes_are_a_finite_value_or_one_sentence(data):
    try:
        value = parse_json(data, "file.json")
    except UserError as error:
        assert one_sentence(error)
    else:
        json.dumps(value, allow_nan=False, ensure_ascii=False).encode()  # raises for NaN and half a surrogate


WRITER = """
import sys
from experiments.files import write_text
print("ready", flush=True)
n = 0
while True:
    n += 1
    write_text(sys.argv[1], str(n % 10) * 200_000)
"""


def test_killed_at_any_moment_a_file_is_whole(tmp_path):
    path = tmp_path / "a"
    for attempt in range(6):
        writer = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE)
        assert writer.stdout.readline() == b"ready\n"
        deadline = time.monotonic() + 120
        while not path.exists() and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(0.003 * attempt)
        writer.send_signal(signal.SIGKILL)
        writer.wait()
        writer.stdout.close()
        text = path.read_text()
        assert len(text) == 200_000 and set(text) == {text[0]}
    left = [name for name in os.listdir(tmp_path) if name != "a"]
    assert all(TEMPORARY_NAME.match(name) for name in left)


def test_a_reader_never_sees_half_a_file(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, [0] * 5000)
    stop = threading.Event()

    def write():
        n = 0
        while not stop.is_set():
            n += 1
            write_json(path, [n] * 5000)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for _ in range(100):
            value = read_json(path, LIMIT)
            assert len(value) == 5000 and len(set(value)) == 1
    finally:
        stop.set()
        writer.join()


def test_numbers_that_json_does_not_know_are_printed_as_null() -> None:
    value = {"a": float("nan"), "b": [1.5, float("inf"), True, None], "c": {"d": "NaN"}}
    line = json_line(value)
    assert json.loads(line, parse_constant=pytest.fail) == {"a": None, "b": [1.5, None, True, None], "c": {"d": "NaN"}}
    assert "\n" not in line
