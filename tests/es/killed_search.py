"""Run by test_checkpoint.py: a search that is slow enough to be killed. Argument: the checkpoints' folder."""

import sys
import time

import jax

# as the tests' own process, so that the two compile the same programs
jax.config.update("jax_num_cpu_devices", 4)

import es_problems  # noqa: E402

import es  # noqa: E402


def slowly(stage, x, key):
    time.sleep(0.2)
    return es_problems.distance_squared(stage, x, key)


es.search(
    slowly,
    es_problems.space(),
    es_problems.TWO_STAGES,
    es_problems.SETTINGS,
    jax.random.key(0),
    lambda progress, aux: print(progress.generations, flush=True),
    es.Checkpointer(sys.argv[1], seconds_between=0.0),
)
