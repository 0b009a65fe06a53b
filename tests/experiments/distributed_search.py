"""Run by test_distributed.py: one process of a search whose cost is cheap, with everything else as in tune.

Arguments: address (or 'cluster'), processes, process, run folder, generation in which this process stops (0: none),
seed. The first process prints the hash of the whole result.
"""

import hashlib
import os
import sys
from pathlib import Path

import jax

jax.config.update("jax_num_cpu_devices", 2)

from experiments import distributed  # noqa: E402

address, processes, process, folder, stop, seed = sys.argv[1:]
if address == "cluster":
    distributed.join(None, None, None)
elif int(processes) > 1:
    distributed.join(address, int(processes), int(process))

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import es  # noqa: E402
from experiments.batch import batched, device_mesh  # noqa: E402

POPULATION, CHUNK = 7, 2  # of 7 the last process has fewer
program = batched(lambda shared, x: jnp.sum((x - shared) ** 2) + jnp.sin(40.0 * x[0]), device_mesh(), CHUNK)
calls = []


def evaluate(stage: es.Stage, x: np.ndarray, key: jax.Array) -> tuple[np.ndarray, None]:
    calls.append(0)
    if len(calls) == int(stop):
        os._exit(9)
    shared = np.asarray(jax.random.normal(key, (x.shape[1],)))
    return distributed.gathered(program(shared, distributed.share(x)), len(x)), None


space = es.ParameterSpace(tuple(es.Parameter(f"p{i}", "m", -1.0, 2.0, 0.5) for i in range(3)))
settings = {"seed": int(seed), "generations": 8}
with distributed.leaving_alone(), distributed.open_run_together(Path(folder), "tune", settings) as run:
    checkpointer = distributed.checkpointer(run / "checkpoints", settings, print)
    checkpointer._seconds_between = 0.0
    key = jax.random.key(0)
    found = es.search(
        evaluate,
        space,
        [es.Stage("only", 8)],
        es.SearchSettings(population=POPULATION),
        key,
        checkpointer=checkpointer,
    )
    if distributed.is_first():
        told = [found.best, found.mean, *(np.asarray(x) for g in found.history for x in g)]
        print("found", found.resumed_at, hashlib.sha256(b"".join(x.tobytes() for x in told)).hexdigest())
    run.mark_finished()
