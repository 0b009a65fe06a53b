"""Where the members of a sweep run: anything with `submit(function, argument)` whose answer has `done` and `result`.

Local processes by default; submitit (SLURM, or its own local executor) and Dask as extras.
"""

import contextlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Protocol

from experiments.errors import UserError
from experiments.files import shown
from experiments.sweep.member import interrupt_running

ExecutorName = Literal["local", "submitit", "dask"]
EXECUTORS: Final[tuple[ExecutorName, ...]] = ("local", "submitit", "dask")


class Future(Protocol):
    """What `concurrent.futures.Future`, submitit's `Job` and Dask's `Future` have in common."""

    def done(self) -> bool: ...
    def result(self) -> Any: ...


class Executor(Protocol):
    """What the three have in common."""

    def submit(self, function: Any, argument: Any) -> Future: ...


@dataclass(frozen=True)
class Place:
    """What the user chose."""

    executor: ExecutorName
    workers: int
    devices: int  # cores of each member
    scheduler: str | None = None  # address of a Dask scheduler; None: a cluster of this machine
    cluster: str | None = None  # of submitit: slurm, local; None: SLURM where there is one
    hours: float = 24.0  # of a SLURM job


@contextlib.contextmanager
def open_executor(place: Place, folder: Path) -> Iterator[Executor]:
    """The executor; what it still runs at the end is told to stop. Raises UserError."""
    opened = {"local": _local, "submitit": _submitit, "dask": _dask}[place.executor]
    with opened(place, folder) as executor:
        yield executor


@contextlib.contextmanager
def _local(place: Place, folder: Path) -> Iterator[Executor]:
    # threads that wait for processes: when a process dies, its thread lives to tell
    pool = ThreadPoolExecutor(place.workers)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        interrupt_running()
        pool.shutdown(wait=True)


@contextlib.contextmanager
def _submitit(place: Place, folder: Path) -> Iterator[Executor]:
    try:
        import submitit
    except ImportError:
        raise UserError("the executor submitit is not installed; pip install 'starleth[slurm]'.") from None
    jobs: list[Any] = []

    class Executor:
        def __init__(self) -> None:
            own = folder / "submitit"
            own.mkdir(mode=0o700, exist_ok=True)  # submitit hands its jobs over in files that run as code
            self.inner = submitit.AutoExecutor(folder=own, cluster=place.cluster)
            self.inner.update_parameters(
                name="starleth", timeout_min=max(1, round(60 * place.hours)), cpus_per_task=place.devices
            )
            if self.inner.cluster == "slurm":
                self.inner.update_parameters(slurm_array_parallelism=place.workers)

        def submit(self, function: Any, argument: Any) -> Future:
            jobs.append(self.inner.submit(function, argument))
            return jobs[-1]

    try:
        executor = Executor()
    except (RuntimeError, ValueError) as error:  # no such cluster, or it is not reached from this machine
        raise UserError(f"submitit finds no cluster to run on ({shown(str(error))}); see --cluster.") from None
    try:
        yield executor
    finally:
        for job in jobs:
            if not job.done():
                job.cancel()


@contextlib.contextmanager
def _dask(place: Place, folder: Path) -> Iterator[Executor]:
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise UserError("the executor dask is not installed; pip install 'starleth[dask]'.") from None
    with contextlib.ExitStack() as stack:
        address: Any = place.scheduler
        if address is None:
            address = stack.enter_context(
                LocalCluster(n_workers=place.workers, threads_per_worker=1, dashboard_address=None, silence_logs=50)
            )
        try:
            client = stack.enter_context(Client(address, timeout="30s", set_as_default=False))
        except (OSError, ValueError, TimeoutError) as error:
            raise UserError(f"the Dask scheduler {place.scheduler} cannot be reached ({error}).") from None
        futures: list[Any] = []

        class Executor:
            def submit(self, function: Any, argument: Any) -> Future:
                futures.append(client.submit(function, argument, pure=False))
                return futures[-1]

        try:
            yield Executor()
        finally:
            client.cancel([future for future in futures if not future.done()])
