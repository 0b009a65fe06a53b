"""Several processes search as one: the same bits, one writer, one sentence when a process is lost or set otherwise."""

import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments.distributed import gathered, join, share
from experiments.errors import UserError

PROGRAM = Path(__file__).parent / "distributed_search.py"
PATIENCE = 1500.0  # s for what takes seconds or compiles, on a machine with ten times more work than cores


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Processes that compile once; nothing of a cluster this may run on."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("SLURM_", "OMPI_", "JAX_"))}
    cache = str(tmp_path_factory.getbasetemp() / "cache_of_distributed")
    return kept | {"JAX_COMPILATION_CACHE_DIR": cache, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}


def free_address() -> str:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{one.getsockname()[1]}"


def together(commands: list[list[str]], environment) -> list[tuple[int, str, str]]:
    """Exit code, stdout and stderr of processes that run at the same time."""
    started = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
        for command in commands
    ]
    try:
        ended = [process.communicate(timeout=PATIENCE) for process in started]
    finally:
        for process in started:
            process.kill()
            process.wait()
    return [(process.returncode, *texts) for process, texts in zip(started, ended, strict=True)]


def search(folder: Path, processes: int, environment, stops=(0, 0), seeds=(0, 0)) -> list[tuple[int, str, str]]:
    address = free_address()
    words = [[address, str(processes), str(i), str(folder), str(stops[i]), str(seeds[i])] for i in range(processes)]
    return together([[sys.executable, str(PROGRAM), *word] for word in words], environment)


def found(ended: list[tuple[int, str, str]]) -> tuple[int, str]:
    """Where the search was resumed and the hash of what it found; only the first process tells."""
    assert [code for code, _, _ in ended] == [0] * len(ended), ended
    assert all("found" not in out for _, out, _ in ended[1:])
    resumed, digest = re.search(r"found (\d+) ([0-9a-f]{64})", ended[0][1]).groups()
    return int(resumed), digest


@pytest.mark.slow
def test_two_processes_find_what_one_finds(tmp_path, environment):
    assert found(search(tmp_path / "two", 2, environment)) == found(search(tmp_path / "alone", 1, environment))


@pytest.mark.slow
def test_a_lost_process_is_told_and_the_search_goes_on_to_the_same_result(tmp_path, environment):
    """The second process dies in its fifth generation: the first says so, and both go on from the fourth."""
    ended = search(tmp_path / "lost", 2, environment, stops=(0, 5))
    assert [code for code, _, _ in ended] == [2, 9]
    said = [line for line in ended[0][2].splitlines() if line.startswith("starleth: ")]
    assert len(said) == 1 and "another process of this search has stopped" in said[0]
    assert "Traceback" not in ended[0][2]
    digest = found(search(tmp_path / "alone", 1, environment))[1]
    assert found(search(tmp_path / "lost", 2, environment)) == (4, digest)


@pytest.mark.slow
def test_processes_with_other_settings_are_all_refused(tmp_path, environment):
    ended = search(tmp_path / "run", 2, environment, seeds=(0, 1))
    assert [code for code, _, _ in ended] == [2, 2]
    assert all("process 1 was given other settings ('seed') than the first" in err for _, _, err in ended[1:])


@pytest.mark.slow
def test_a_refused_folder_and_other_checkpoints_are_told_by_every_process(tmp_path, environment):
    (tmp_path / "thesis.tex").write_text("x")
    ended = search(tmp_path, 2, environment)
    assert [code for code, _, _ in ended] == [2, 2] and all("holds other files" in err for _, _, err in ended)


@pytest.mark.slow
def test_under_slurm_the_processes_find_each_other(tmp_path, environment):
    """What SLURM tells its tasks is all that is given; the port follows from the job's number."""
    job = {"SLURM_JOB_ID": str(os.getpid()), "SLURM_NTASKS": "2"}
    job |= dict.fromkeys(("SLURM_STEP_NODELIST", "SLURM_JOB_NODELIST"), "127.0.0.1")
    started = []
    for i in "01":
        task = job | {"SLURM_PROCID": i, "SLURM_LOCALID": i}
        words = [sys.executable, str(PROGRAM), "cluster", "2", i, str(tmp_path / "run"), "0", "0"]
        started.append(subprocess.Popen(words, env=environment | task, stdout=subprocess.PIPE, text=True))
    ended = [(process.communicate(timeout=PATIENCE)[0], process.returncode) for process in started]
    assert [code for _, code in ended] == [0, 0]
    assert "found 0" in ended[0][0] and "found" not in ended[1][0]


@pytest.mark.parametrize(
    ("words", "match"),
    [
        ((None, 2, 0), "--coordinator is missing"),
        (("localhost:1", 2, None), "--process is missing"),
        (("localhost", 2, 0), "host:port"),
        (("localhost:99:1", 2, 0), "host:port"),
        (("localhost:9999", 2, 2), "no process 2 of 2"),
        ((None, None, None), "no cluster was recognised"),
    ],
)
def test_bad_words_are_one_sentence(monkeypatch, words, match):
    for name in list(os.environ):
        if name.startswith(("SLURM_", "OMPI_", "JAX_")):
            monkeypatch.delenv(name)
    with pytest.raises(UserError, match=match) as refusal:
        join(*words)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("count", [1, 5, 8])
@pytest.mark.parametrize("processes", [2, 3, 4])
@pytest.mark.parametrize("chunk", [1, 3])
def test_shares_put_together_are_everything(monkeypatch, count, processes, chunk):
    """The gathering is that of JAX; here only which members go where."""
    members = {"x": np.arange(count), "y": np.arange(2.0 * count).reshape(count, 2)}
    parts = []
    for process in range(processes):
        monkeypatch.setattr("jax.process_count", lambda: processes)
        monkeypatch.setattr("jax.process_index", lambda p=process: p)
        parts.append(share(members, chunk))
    assert len({len(part["x"]) for part in parts}) == 1
    assert len(parts[0]["x"]) % chunk == 0, "a member would change its place in its chunk"
    monkeypatch.setattr(
        "experiments.distributed._gather", lambda _: {k: np.concatenate([p[k] for p in parts]) for k in members}
    )
    whole = gathered(parts[0], count)
    assert all(np.array_equal(whole[name], members[name]) for name in members)


@pytest.mark.slow
def test_a_jump_searched_by_two_processes_is_that_of_one(tmp_path, environment):
    """The command itself, with the robot."""
    tune = [sys.executable, "-m", "experiments.cli.main", "tune", "squat_jump", "--generations", "4"]
    tune += ["--population", "5", "--devices", "1", "--output"]
    assert together([[*tune, str(tmp_path / "one")]], environment)[0][0] == 0
    by_hand = ["--coordinator", free_address(), "--processes", "2", "--process"]
    ended = together([[*tune, str(tmp_path / "two"), *by_hand, str(i)] for i in range(2)], environment)
    assert [code for code, _, _ in ended] == [0, 0], ended
    assert "parameters.json" in ended[0][2] and "parameters.json" not in ended[1][2]
    one, two = (json.loads((tmp_path / name / "parameters.json").read_text()) for name in ("one", "two"))
    for key in ("parameters", "metrics", "cost_terms"):
        assert one[key] == two[key]
