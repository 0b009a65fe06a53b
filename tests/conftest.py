"""Several virtual CPU devices and strict numerics for every test; set before JAX starts its backend."""

import jax
import pytest

from experiments.cli.options import available_cores

MOST_WORKERS = 4  # each compiles its own programs: about 2 GB

jax.config.update("jax_num_cpu_devices", 4)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One worker per core; none with `-s`, as a worker would swallow the figures that it asks to see."""
    cores = min(available_cores(), MOST_WORKERS)
    return cores if cores > 1 and config.getoption("capture") != "no" else 0
