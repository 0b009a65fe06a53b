"""Nothing lost: runs killed at any moment and files torn at any byte are continued to the same result or refused.

`pytest -m slow tests/experiments/test_kills.py -s` prints the counts; STARLETH_KILLS sets how many (200).
"""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import cheap_tune
import numpy as np
import pytest

import es
from experiments.errors import UserError

HERE = Path(__file__).parent
MANY = int(os.environ.get("STARLETH_KILLS", "200"))
PATIENCE = 900.0  # s for a run of seconds, on a machine with ten times more work than cores
GENERATIONS = 8


def kill_runs(folder: Path, kills: int, seed: int) -> dict:
    """What killed_runs.py tells."""
    cache = {"JAX_COMPILATION_CACHE_DIR": str(folder / "cache"), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    done = subprocess.run(
        [sys.executable, HERE / "killed_runs.py", folder, str(kills), str(seed)],
        capture_output=True,
        text=True,
        cwd=HERE,
        env=os.environ | cache,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_runs_killed_at_random_moments_end_with_the_same_file(tmp_path):
    assert kill_runs(tmp_path, 2, seed=0)["kills"] == 2


@pytest.mark.slow
def test_many_runs_killed_at_random_moments_end_with_the_same_file(tmp_path):
    told = kill_runs(tmp_path, MANY, seed=int(time.time()))
    print(json.dumps({"kills": told["kills"], "runs": told["runs"], "left_at": Counter(told["left_at"])}))
    assert told["kills"] == MANY and max(told["left_at"]) > 0


# --- torn files


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> dict[str, Path]:
    """A finished run, and the same run interrupted in its sixth generation. Copied before use."""
    base = tmp_path_factory.mktemp("torn")
    cheap_tune.run(base / "finished", 0, GENERATIONS)
    with pytest.raises(es.SearchInterrupted):
        cheap_tune.run(base / "interrupted", 0, GENERATIONS, interrupt_in=6)
    return {"finished": base / "finished", "interrupted": base / "interrupted"}


def tear(path: Path, chance: random.Random) -> str:
    """What a crash or a disk does to a file; says which."""
    content = path.read_bytes()
    kind = chance.choice(["torn", "torn", "zeroed", "flipped", "gone"])
    at = chance.randrange(len(content)) if content else 0
    if kind == "torn":
        path.write_bytes(content[:at])
    elif kind == "zeroed":
        path.write_bytes(content[:at] + bytes(len(content) - at))
    elif kind == "flipped" and content:
        path.write_bytes(content[:at] + bytes([content[at] ^ 1 << chance.randrange(8)]) + content[at + 1 :])
    else:
        path.unlink()
    return kind


def tear_and_resume(source: Path, work: Path, seed: int) -> str:
    """How a run goes on after one of its files was torn: 'resumed' to the same bytes, or 'refused'."""
    chance = random.Random(seed)
    folder = Path(shutil.copytree(source, work / "torn"))
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    victim = chance.choice(files)
    how = f"seed {seed}: {victim.relative_to(folder)} {tear(victim, chance)}"
    expected = json.loads((source.parent / "finished" / "parameters.json").read_text())["checksum"]
    try:
        checksum = cheap_tune.run(folder, 0, GENERATIONS)
    except UserError as error:
        text = str(error)
        assert "\n" not in text and text.endswith("."), how
        return "refused"
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    assert checksum == expected, f"{how}: silently another result"
    return "resumed"


@pytest.mark.parametrize("state", ["finished", "interrupted"])
def test_torn_files_are_survived_or_refused(folders, tmp_path, state):
    for seed in range(5):
        tear_and_resume(folders[state], tmp_path, seed)


@pytest.mark.slow
def test_many_torn_files_are_survived_or_refused(folders, tmp_path):
    first = int(time.time())
    ended = Counter()
    for i in range(MANY):
        state = "finished" if i % 4 == 0 else "interrupted"
        ended[f"{state} {tear_and_resume(folders[state], tmp_path, first + i)}"] += 1
    print(json.dumps({"torn": MANY, "ended": ended}))
    assert sum(ended.values()) == MANY and ended["interrupted resumed"] > MANY // 2


@pytest.mark.slow
def test_sigterm_leaves_a_resumable_run(tmp_path):
    """As a cluster asks a job to go: exit code of an interrupt, no traceback, the same result when continued."""
    words = ["cheap", "--seed=0", f"--generations={GENERATIONS}", f"--output={tmp_path / 'run'}"]
    command = [sys.executable, HERE / "cheap_tune.py", *words]
    process = subprocess.Popen([*command, "--pause=0.3"], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + PATIENCE
    while not any((tmp_path / "run").glob("checkpoints/generation_*")):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == cheap_tune.INTERRUPTED and "Traceback" not in said
    interrupted = cheap_tune.run(tmp_path / "run", 0, GENERATIONS)
    assert interrupted == cheap_tune.run(tmp_path / "whole", 0, GENERATIONS)


# --- the command itself


@pytest.mark.slow
def test_a_real_tune_killed_at_random_moments_is_continued_to_the_same_parameters(tmp_path):
    """SIGKILL and SIGTERM in turn, at moments spread over the time that an uninterrupted run takes."""
    command = [sys.executable, "-m", "experiments.cli.main", "tune", "squat_jump", "--generations", "6"]
    command += ["--population", "4", "--devices", "1", "--output"]
    subprocess.run([*command, str(tmp_path / "warm")], check=True, capture_output=True)
    began = time.monotonic()
    subprocess.run([*command, str(tmp_path / "whole")], check=True, capture_output=True)
    duration = time.monotonic() - began
    expected = json.loads((tmp_path / "whole" / "parameters.json").read_text())["parameters"]
    chance = np.random.default_rng(int(began))
    codes = []
    while len(codes) < int(os.environ.get("STARLETH_REAL_KILLS", "6")):
        number = signal.SIGTERM if len(codes) % 2 else signal.SIGKILL
        process = subprocess.Popen([*command, str(tmp_path / "run")], stderr=subprocess.PIPE, text=True)
        try:
            process.communicate(timeout=chance.uniform(0.2, 1.0) * duration)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
        _, said = process.communicate()
        assert "Traceback" not in said, said
        codes.append(process.returncode)
        if process.returncode == 0:
            break
    subprocess.run([*command, str(tmp_path / "run")], check=True, capture_output=True)
    assert json.loads((tmp_path / "run" / "parameters.json").read_text())["parameters"] == expected
    print(json.dumps({"codes": codes}))
