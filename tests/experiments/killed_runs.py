"""Run by test_kills.py: kills whole runs (run folder, search, checkpoints, export) again and again, with SIGKILL.

Arguments: folder, number of kills, seed of the chance. Each run is killed at up to four moments, spread over the time
that an uninterrupted one takes, then left to end, and what it leaves is compared with the uninterrupted run's. Every
process is forked from this one, which has imported everything but not started JAX's backend. Prints one JSON line.
"""

import json
import os
import random
import signal
import sys
import time
from pathlib import Path

import cheap_tune

KILLS_PER_RUN = 4
GENERATIONS = 8


def forked(folder: Path, seed: int, kill_after: float | None = None) -> tuple[int, float]:
    """Exit code (below zero: the signal) and seconds of one process that runs or continues the search."""
    began = time.monotonic()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            cheap_tune.run(folder, seed, GENERATIONS)
            code = 0
        finally:
            os._exit(code)
    if kill_after is not None:
        time.sleep(kill_after)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status), time.monotonic() - began


def result(folder: Path) -> bytes:
    return (folder / "parameters.json").read_bytes()


def main(folder: Path, kills: int, seed: int) -> None:
    chance = random.Random(seed)
    forked(folder / "warm", 0)  # compiles
    code, duration = forked(folder / "whole", 0)
    assert code == 0
    expected = result(folder / "whole")
    killed, runs, generations = 0, 0, []
    while killed < kills:
        run = folder / f"run_{runs}"
        runs += 1
        for _ in range(min(KILLS_PER_RUN, kills - killed)):
            code, _ = forked(run, 0, chance.uniform(0.0, duration))
            if code == 0:  # it was over before
                break
            assert code == -signal.SIGKILL, f"run {runs}: exit code {code}"
            killed += 1
            found = [path.name for path in run.glob("checkpoints/generation_*")]
            generations.append(max((int(name[-8:]) for name in found), default=0))
        code, _ = forked(run, 0)
        assert code == 0, f"run {runs}: after {killed} kills it ended with {code}"
        assert result(run) == expected, f"run {runs}: after {killed} kills the result is another"
    print(json.dumps({"kills": killed, "runs": runs, "seconds_of_one": duration, "left_at": generations}))


main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
