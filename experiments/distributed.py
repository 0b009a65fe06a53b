"""One search over several processes: each scores its share of a generation, all know all scores, one writes.

    starleth tune … --distributed                                  under SLURM, Open MPI, Kubernetes: found by itself
    starleth tune … --coordinator host:port --processes 2 --process 0        by hand, the same words but --process 1

Every process runs the same search (drawing and ranking are the same arithmetic everywhere), compiles the same
program for its own devices, and exchanges only scores, by `jax.distributed` (gloo between CPUs). The chunk, and with
it the arithmetic of a member, does not depend on the number of processes: one or many find the same to the bit.
The first process alone reads and writes the run folder and prints; the others need not even see its disk.
"""

import contextlib
import io
import json
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import jax
import numpy as np

from es import Checkpointer, CheckpointError, SearchInterrupted
from es.checkpoint_files import first_line
from experiments.errors import UserError
from experiments.run_folder import RunFolder, open_run

WAIT: Final = 300  # s for all processes to come up: nodes of a cluster do not start at once
INTERRUPTED: Final = 130
_ADDRESS: Final = re.compile(r"^(\[[0-9A-Fa-f:]+\]|[A-Za-z0-9.\-]+):\d{1,5}$")


def is_first() -> bool:
    """Whether this process is the one that writes and prints."""
    return jax.process_index() == 0


def join(coordinator: str | None, processes: int | None, process: int | None) -> None:
    """Meet the other processes; what is None is taken from the cluster's environment. Raises UserError.

    Must come before the first JAX array.
    """
    given = {"--coordinator": coordinator, "--processes": processes, "--process": process}
    missing = [name for name, value in given.items() if value is None]
    if 0 < len(missing) < len(given):
        raise UserError(f"--coordinator, --processes and --process belong together; {missing[0]} is missing.")
    if coordinator is not None and not _ADDRESS.match(coordinator):
        raise UserError(f"'{coordinator[:100]}' is no address; give --coordinator as host:port.")
    if processes is not None and process is not None and not 0 <= process < processes:
        raise UserError(f"there is no process {process} of {processes}; the first is 0, the last {processes - 1}.")
    # it would take SIGTERM, which leaves a resumable run here
    jax.config.update("jax_enable_preemption_service", False)
    try:
        jax.distributed.initialize(coordinator, processes, process, initialization_timeout=WAIT)
    except (ValueError, RuntimeError, KeyError, OSError) as error:  # JaxRuntimeError is a RuntimeError
        if not missing:
            raise UserError(f"the other processes cannot be reached ({first_line(error)}).") from None
        raise UserError(
            f"no cluster was recognised ({first_line(error)}); give --coordinator host:port, --processes and --process."
        ) from None


@contextlib.contextmanager
def leaving_alone() -> Iterator[None]:
    """Around what may fail in one process: it ends at once, and does not wait for the others to end as well."""
    try:
        yield
    except (UserError, KeyboardInterrupt, SearchInterrupted, SystemExit) as error:
        if jax.process_count() == 1:
            raise
        code = error.code if isinstance(error, SystemExit) else 2 if isinstance(error, UserError) else INTERRUPTED
        if isinstance(error, UserError):
            print(f"starleth: {error}", file=sys.stderr)
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code if isinstance(code, int) else 1)


def share(members: Any, chunk: int = 1) -> Any:
    """This process's members: equal parts in the order of the processes, the last member repeated to fill them.

    Parts are whole chunks: a member keeps its place in its chunk, on which the last bit of its score depends.
    """
    processes = jax.process_count()
    if processes == 1:
        return members
    count = len(jax.tree.leaves(members)[0])
    size = -(-count // (processes * chunk)) * chunk
    mine = np.minimum(np.arange(size) + size * jax.process_index(), count - 1)
    return jax.tree.map(lambda x: np.asarray(x)[mine], members)


def gathered(outputs: Any, count: int) -> Any:
    """The outputs of all members from each process's share. Raises UserError when another process is gone."""
    if jax.process_count() == 1:
        return outputs
    return jax.tree.map(lambda x: x[:count], _gather(outputs))


@contextlib.contextmanager
def open_run_together(path: Path, command: str, settings: Mapping[str, Any]) -> Iterator[RunFolder]:
    """`open_run` by the first process for all of them. Raises UserError in all if it does in one."""
    with contextlib.ExitStack() as stack:
        if jax.process_count() == 1:
            yield stack.enter_context(open_run(path, command, settings))
            return
        run = None

        def opened() -> dict[str, Any]:
            nonlocal run
            run = stack.enter_context(open_run(path, command, settings))
            return {"settings": run.settings, "resumed": run.resumed, "finished": run.finished}

        told = json.loads(_from_first(lambda: json.dumps(opened()).encode()))
        mine = json.loads(json.dumps(dict(settings)))
        different = [name for name in sorted(mine | told["settings"]) if mine.get(name) != told["settings"].get(name)]
        equal = _gather(np.array([not different]))
        if not equal.all():
            which = int(np.flatnonzero(~equal)[0])
            why = f" ('{different[0]}')" if different else ""
            raise UserError(f"process {which} was given other settings{why} than the first; give all of them the same.")
        yield run or _NotHere(path, command, mine, told["resumed"], told["finished"])


class _NotHere(RunFolder):
    """The run folder as the other processes see it: it is the first one's."""

    def mark_finished(self) -> None:
        pass


class SharedCheckpointer(Checkpointer):
    """The first process reads and writes the checkpoints; the others are told what it read."""

    def open(self, search: Mapping[str, Any]) -> None:
        self._described = dict(search)  # the folder is made in `load`, where an error reaches all processes

    def load(self) -> dict[str, np.ndarray] | None:
        def read() -> bytes:
            super(SharedCheckpointer, self).open(self._described)
            arrays = super(SharedCheckpointer, self).load()
            if arrays is None:
                return b""
            buffer = io.BytesIO()
            np.savez(buffer, **arrays)
            return buffer.getvalue()

        try:
            data = _from_first(read)
        except UserError as error:
            raise CheckpointError(str(error)) from None
        if not data:
            return None
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return dict(arrays)


def checkpointer(directory: Path, identity: Mapping[str, Any], notify: Callable[[str], None]) -> Checkpointer:
    """The checkpoints of a search in one process or several."""
    kind = Checkpointer if jax.process_count() == 1 else SharedCheckpointer
    return kind(directory, identity, notify=notify)


def _from_first(make: Callable[[], bytes]) -> bytes:
    """What the first process makes, in all of them; its UserError or CheckpointError, too, as a UserError."""
    from jax.experimental import multihost_utils

    data, failed = b"", 0
    if is_first():
        try:
            data = make()
        except (UserError, CheckpointError) as error:
            data, failed = str(error).encode(), 1
    size, failed = (int(x) for x in _gather(np.array([[len(data), failed]], np.int32))[0])
    mine = np.frombuffer(data, np.uint8) if is_first() else np.zeros(size, np.uint8)
    with _lost_process():
        sent = multihost_utils.broadcast_one_to_all(mine) if size else mine
    answer = np.asarray(sent, np.uint8).tobytes()
    if failed:
        raise UserError(answer.decode())
    return answer


def _gather(tree: Any) -> Any:
    from jax.experimental import multihost_utils

    with _lost_process(), jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        return multihost_utils.process_allgather(tree, tiled=True)


@contextlib.contextmanager
def _lost_process() -> Iterator[None]:
    try:
        yield
    except jax.errors.JaxRuntimeError as error:
        raise UserError(
            f"another process of this search has stopped ({first_line(error)}); "
            "start all of them again with the same commands, the search continues from its last checkpoint."
        ) from None
