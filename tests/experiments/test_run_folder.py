"""Run folders: one process at a time, nothing mixed, killed runs taken over."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from experiments import run_folder
from experiments.errors import UserError
from experiments.files import write_text
from experiments.run_folder import RUN_FILE, make_answer_folder, open_run

SETTINGS = {"task": "squat_jump", "seed": 1, "stages": ("loose", "full"), "devices": 2}

HOLDER = """
import sys, time
from experiments.run_folder import open_run
settings = {"task": "squat_jump", "seed": 1, "stages": ["loose", "full"], "devices": 2}
with open_run(sys.argv[1], "tune", settings):
    print("holding", flush=True)
    time.sleep(120)
"""


def refused(path, match, command="tune", settings=SETTINGS, **options):
    with pytest.raises(UserError, match=match) as caught, open_run(path, command, settings, **options):
        pass
    text = str(caught.value)
    assert "\n" not in text and text.endswith(".") and len(text) < 600


@pytest.fixture
def hold():
    """Start another process that holds a folder."""
    with ExitStack() as stack:

        def start(path):
            holder = subprocess.Popen([sys.executable, "-c", HOLDER, str(path)], stdout=subprocess.PIPE)
            stack.callback(holder.stdout.close)
            stack.callback(holder.wait)
            stack.callback(holder.kill)
            assert holder.stdout.readline() == b"holding\n"
            return holder

        yield start


def test_a_new_run_is_resumed_until_it_is_finished(tmp_path):
    path = tmp_path / "runs" / "jump"
    with open_run(path, "tune", SETTINGS) as run:
        assert not run.resumed and not run.finished
        write_text(run / "notes.txt", "work")
    with open_run(path, "tune", SETTINGS) as run:
        assert run.resumed and not run.finished
        run.mark_finished()
    with open_run(path, "tune", SETTINGS) as run:
        assert run.resumed and run.finished
    assert (path / "notes.txt").read_text() == "work"


def test_a_folder_in_use_is_refused_and_taken_over_after_a_kill(tmp_path, hold):
    holder = hold(tmp_path / "run")
    refused(tmp_path / "run", f"in use by another run .by process {holder.pid} on")
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    with open_run(tmp_path / "run", "tune", SETTINGS) as run:
        assert run.resumed


def test_one_process_cannot_open_a_folder_twice(tmp_path):
    with open_run(tmp_path, "tune", SETTINGS):
        refused(tmp_path, "in use")
    with open_run(tmp_path, "tune", SETTINGS):
        pass


def test_a_failed_run_releases_its_folder(tmp_path):
    with pytest.raises(RuntimeError), open_run(tmp_path, "tune", SETTINGS):
        raise RuntimeError
    with open_run(tmp_path, "tune", SETTINGS) as run:
        assert run.resumed


def test_of_many_that_start_at_once_one_gets_the_folder(tmp_path):
    code = HOLDER.replace("time.sleep(120)", "sys.stdin.read()")
    racers = [
        subprocess.Popen(
            [sys.executable, "-c", code, str(tmp_path / "new" / "run")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        for _ in range(4)
    ]
    try:
        # the losers leave at once, the winner holds on until its input ends
        while sum(racer.poll() is None for racer in racers) > 1:
            time.sleep(0.02)
        (winner,) = [racer for racer in racers if racer.poll() is None]
        outputs = [racer.communicate(timeout=60) for racer in racers if racer is not winner]
        assert all(out == b"" and b"is in use by another run" in err for out, err in outputs)
        assert winner.communicate(timeout=60)[0] == b"holding\n" and winner.returncode == 0
    finally:
        for racer in racers:
            racer.kill()


def test_a_folder_with_other_files_is_refused_and_left_as_it_was(tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    refused(tmp_path, "other files .thesis.tex")
    assert os.listdir(tmp_path) == ["thesis.tex"]


@pytest.mark.parametrize(
    ("command", "change", "match"),
    [
        ("tune", {"seed": 2}, "seed was 1, now 2"),
        ("tune", {"noise": 0.1}, "noise was None, now 0.1"),
        ("tune", {"stages": ["loose", "fast"]}, "stages.1 was full, now fast"),
        ("robustness", {}, "holds a run of 'tune'"),
    ],
)
def test_another_run_is_refused(tmp_path, command, change, match):
    with open_run(tmp_path, "tune", SETTINGS):
        pass
    refused(tmp_path, match, command, SETTINGS | change)


def test_settings_that_may_differ(tmp_path):
    with open_run(tmp_path, "tune", SETTINGS):
        pass
    with open_run(tmp_path, "tune", SETTINGS | {"devices": 1}, may_differ=("devices",)) as run:
        assert run.resumed and run.settings["devices"] == 1


def test_places_where_no_folder_can_be(tmp_path):
    (tmp_path / "file").write_text("")
    refused(tmp_path / "file", "not a folder")
    refused(tmp_path / "file" / "below", "not a folder")
    refused(tmp_path / ("x" * 300), "cannot make the folder")
    refused("a\0b", "cannot make the folder")
    refused("/proc/run", "cannot make the folder")


def test_a_folder_without_write_permission():
    place = Path(tempfile.mkdtemp())  # not tmp_path: that lies in a folder which only its owner may enter
    place.chmod(0o555)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        refused(place, "cannot write into .*permission denied")
        refused(place / "below", "cannot make the folder .*permission denied")
    finally:
        if root:
            os.seteuid(0)
        place.rmdir()


def test_a_disk_with_hardly_any_room(tmp_path, monkeypatch):
    monkeypatch.setattr(run_folder, "MIN_FREE_BYTES", 2**62)
    refused(tmp_path, "almost full")


def test_what_a_killed_write_left_is_removed(tmp_path):
    with open_run(tmp_path, "tune", SETTINGS):
        pass
    left = tmp_path / ".best.npz.0123456789abcdef.tmp"
    left.write_text("half")
    other = tmp_path / ".hidden.tmp"
    other.write_text("not ours")
    with open_run(tmp_path, "tune", SETTINGS):
        assert not left.exists() and other.exists()


@pytest.mark.parametrize("content", ["", "[]", "{", '{"command": "tune"}', "[" * 9000, '{"schema_version": true}'])
def test_a_damaged_record_is_named(tmp_path, content):
    (tmp_path / RUN_FILE).write_text(content)
    refused(tmp_path, RUN_FILE)


def test_a_record_torn_at_any_byte_is_refused(tmp_path):
    with open_run(tmp_path, "tune", SETTINGS):
        pass
    whole = (tmp_path / RUN_FILE).read_bytes()
    for length in range(len(whole) - 2):  # without the last newline it is still whole
        (tmp_path / RUN_FILE).write_bytes(whole[:length])
        refused(tmp_path, RUN_FILE)


def test_a_record_of_a_later_version_is_refused(tmp_path):
    with open_run(tmp_path, "tune", SETTINGS):
        pass
    record = json.loads((tmp_path / RUN_FILE).read_text())
    (tmp_path / RUN_FILE).write_text(json.dumps(record | {"schema_version": 2}))
    refused(tmp_path, "another version")


@pytest.mark.parametrize("name", ["a file", "a file/below", "/dev/null", "/proc/sys/no_such", "\0", "x" * 300])
def test_a_place_for_an_answer_that_cannot_be_made_is_one_sentence(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a file").write_text("x")
    with pytest.raises(UserError, match=r"give another output folder\.$") as error:
        make_answer_folder(name)
    assert str(error.value).isprintable()


def test_an_answer_does_not_overwrite_the_report_of_a_run(tmp_path):
    make_answer_folder(tmp_path / "a" / "b")
    make_answer_folder(tmp_path / "a" / "b")
    with open_run(tmp_path / "run", "tune", SETTINGS):
        pass
    with pytest.raises(UserError, match="holds a run, whose report would be lost"):
        make_answer_folder(tmp_path / "run")
