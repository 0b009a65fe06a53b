"""Several virtual CPU devices, strict numerics and one compilation cache for every test; set before JAX starts."""

import atexit
import os
import shutil
import tempfile

import jax
import pytest

from experiments.cli.options import available_cores

MOST_WORKERS = 4  # each compiles its own programs: about 2 GB

jax.config.update("jax_num_cpu_devices", 4)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

# Many tests want the same program. The workers and the commands that tests start inherit the folder.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="starleth_compiled_")
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One worker per core; none with `-s`, as a worker would swallow the figures that it asks to see."""
    cores = min(available_cores(), MOST_WORKERS)
    return cores if cores > 1 and config.getoption("capture") != "no" else 0
