"""Options that several subcommands share, and what must happen before JAX starts."""

import math
import os
from pathlib import Path
from typing import Annotated

import typer

from experiments.errors import UserError

ModelOption = Annotated[
    Path | None,
    typer.Option("--model", help="Model file (model.json or bare robot numbers). Default: nominal StarlETH."),
]
EffectsOption = Annotated[
    list[Path] | None,
    typer.Option("--effects", help="Your own effect, a short Python file; may be repeated. Runs as code."),
]
DevicesOption = Annotated[int, typer.Option("--devices", min=1, help="CPU devices to use; default: one per core.")]
WHOLE_LOOPS = (
    "xla_cpu_small_while_loop_byte_threshold=1000000000",  # every loop counts as small
    "xla_cpu_disable_loop_unrolling=true",  # unrolled first, loops over a chunk are not vectorised
)
SeedOption = Annotated[int, typer.Option("--seed", min=0, max=2**31 - 1, help="Seed of everything random.")]


def finite(value: float | None) -> float | None:
    """Callback of options that are numbers: a NaN passes every range. Raises typer.BadParameter."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is no finite number.")
    return value


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def whole_loops() -> None:
    """Have XLA put a loop over rollouts, all that is in it included, into one function for the CPU.

    Left alone it runs the thousand little kernels of a control period one by one, and starting them takes most of the
    time (`starleth bench`). Must come before JAX starts; leaves alone what the user has set in XLA_FLAGS.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_backend_extra_options" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_extra_options={','.join(WHOLE_LOOPS)}".strip()


def start_jax(devices: int | None = None) -> int:
    """One virtual CPU device per core (or as many as asked for) and a private compilation cache; returns the count.

    Must come before the first JAX array. With an accelerator present JAX uses that instead.
    """
    import jax

    cores = available_cores()
    count = devices or cores
    if count > 4 * cores:
        raise UserError(f"{count} devices are too many for this process's cores; use --devices {cores}.")
    jax.config.update("jax_num_cpu_devices", count)
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "starleth" / "jax"
        try:
            base.mkdir(parents=True, exist_ok=True, mode=0o700)
            jax.config.update("jax_compilation_cache_dir", str(base))
            jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
        except OSError:
            pass  # without a cache every run compiles: slower, not wrong
    return count
