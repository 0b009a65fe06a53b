"""Run by test_checkpoint.py: kills a process that does nothing but write checkpoints, again and again.

Arguments: folder, number of kills. Each process is forked from this one (before JAX's backend starts, which does not
survive a fork), loads what the last one left, checks it, and writes on until it is killed. Prints the generation that
each process found; exits with 1 if one found anything that was not written whole.
"""

import os
import random
import signal
import sys
import time
import warnings

import numpy as np

import es

warnings.simplefilter("ignore")


def arrays(generation: int) -> dict[str, np.ndarray]:
    """Content that tells which generation it belongs to, of growing size as the history is."""
    rng = np.random.default_rng(generation)
    return {"position": np.array([generation]), "table": rng.standard_normal((100 + generation, 3))}


def write_until_killed(folder: str, ready: int) -> None:
    checkpointer = es.Checkpointer(folder, seconds_between=0.0)
    checkpointer.open({"search": "kill"})
    found = checkpointer.load()
    generation = 0 if found is None else int(found["position"][0])
    if found is not None and found["table"].tobytes() != arrays(generation)["table"].tobytes():
        os._exit(1)
    print(generation, flush=True)
    while True:
        generation += 1
        os.write(ready, b"x")
        checkpointer.save(generation, arrays(generation))


def main(folder: str, kills: int) -> None:
    chance = random.Random(0)
    for _ in range(kills + 1):  # the last one only to look at what the kill before it left
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            write_until_killed(folder, writing)
        os.close(writing)
        times = [time.monotonic() for _ in range(chance.randint(2, 4)) if os.read(reading, 1)]
        if times:  # none if the child has ended by itself
            time.sleep(chance.uniform(0.0, (times[-1] - times[0]) / (len(times) - 1)))  # somewhere in the next write
        os.kill(child, signal.SIGKILL)
        os.close(reading)
        _, status = os.waitpid(child, 0)
        if not os.WIFSIGNALED(status):
            sys.exit(1)


main(sys.argv[1], int(sys.argv[2]))
