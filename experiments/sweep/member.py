"""One member of a sweep: `starleth tune` in a process of its own, and how it ended.

`run_member` is what every executor gets: a plain function of plain values, in this process, in a SLURM job or on a
Dask worker. A tune that dies, whatever of, takes nothing else with it.
"""

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from experiments.errors import UserError
from experiments.files import read_json, shown, write_json
from experiments.parameter_file import read_parameters
from experiments.parameter_schema import ParameterFile
from experiments.run_folder import RUN_FILE
from experiments.sweep.definition import LOGS, MEMBERS, OUTCOMES

INTERRUPTED: Final = 130
REFUSED: Final = 2  # bad input: a second attempt would say the same
MAX_BYTES: Final = 100_000
LAST_WORDS: Final = 4_000  # bytes of a log in which its last sentence is looked for
PR_SET_PDEATHSIG: Final = 1


TUNE: Final = (sys.executable, "-m", "experiments.sweep.member", "tune")


@dataclass(frozen=True)
class Job:
    """One attempt at a member: where, the words after `starleth tune`, and what stands for `starleth tune`."""

    folder: str  # of the sweep
    name: str
    arguments: tuple[str, ...]
    attempt: int = 1
    program: tuple[str, ...] = TUNE


@dataclass(frozen=True)
class Outcome:
    """How a member's last attempt ended."""

    name: str
    exit_code: int  # below zero: the signal that killed it
    sentence: str  # why it failed; empty where it did not
    attempt: int
    seconds: float


_running: set[subprocess.Popen] = set()  # in this process, so that an interrupt can be handed on


def run_member(job: Job) -> Outcome:
    """Run one member to its end; never raises for a tune that fails. The outcome is also left in the sweep's folder."""
    folder = Path(job.folder)
    log = folder / LOGS / f"{job.name}.log"
    command = [*job.program, *job.arguments, f"--output={folder / MEMBERS / job.name}"]
    began = time.monotonic()
    with log.open("ab") as printed:
        # a session of its own: a terminal's Ctrl-C must reach it once, from us
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.STDOUT, start_new_session=True
        )
        _running.add(process)
        try:
            code = process.wait()
        except KeyboardInterrupt:
            interrupt_running()
            process.wait()
            raise
        finally:
            _running.discard(process)
    outcome = Outcome(job.name, code, _why(code, log), job.attempt, round(time.monotonic() - began, 1))
    write_json(folder / OUTCOMES / f"{job.name}.json", asdict(outcome))
    return outcome


def interrupt_running() -> None:
    """Ask the members of this process to stop where they can be gone on with."""
    for process in tuple(_running):
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGINT)


def _why(code: int, log: Path) -> str:
    if code == 0:
        return ""
    if code < 0:
        return f"it was killed by {_signal_name(-code)}"
    lines = [line.strip() for line in read_tail(log).splitlines() if line.strip()]
    told = next((line for line in reversed(lines) if line.startswith("starleth: ")), lines[-1] if lines else "")
    return shown(told.removeprefix("starleth: ")) or f"it ended with exit code {code} and no word"


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def read_tail(path: Path) -> str:
    """The last words of a file."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, os.fstat(file.fileno()).st_size - LAST_WORDS))
            return file.read(LAST_WORDS).decode(errors="replace")
    except OSError:
        return ""


def read_outcome(folder: Path, name: str) -> Outcome | None:
    """How the last attempt ended, None if there was none or its file cannot be read: it is only for people."""
    path = folder / OUTCOMES / f"{name}.json"
    kinds: dict[str, Any] = {"name": str, "exit_code": int, "sentence": str, "attempt": int, "seconds": (int, float)}
    try:
        content = read_json(path, MAX_BYTES)
    except UserError:
        return None
    if not isinstance(content, dict) or content.keys() != kinds.keys():
        return None
    return Outcome(**content) if all(isinstance(content[name], kind) for name, kind in kinds.items()) else None


def result_of(folder: Path, name: str) -> ParameterFile | None:
    """The parameters of a finished member, None if it is not finished. Raises UserError if its files are damaged."""
    run = folder / MEMBERS / name
    if not (run / RUN_FILE).exists():
        return None
    record = read_json(run / RUN_FILE, MAX_BYTES * 10)
    if not isinstance(record, dict) or record.get("finished") is not True:
        return None
    return read_parameters(run / "parameters.json", allow_ungated=True)


def die_with_parent() -> None:
    """Have the kernel kill this process when the one that started it is gone, so that no tune is left behind."""
    parent = os.getppid()
    with contextlib.suppress(OSError, AttributeError):  # Linux only
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    die_with_parent()
    from experiments.cli.main import main

    sys.argv[0] = "starleth"
    main()
