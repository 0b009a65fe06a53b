"""Running a sweep: what is finished stays, the rest is submitted, a failure is tried once more, then named."""

import contextlib
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from experiments.errors import UserError
from experiments.files import read_json, shown
from experiments.run_folder import RUN_FILE
from experiments.sweep.definition import LOGS, MAX_BYTES, MEMBERS, OUTCOMES, Member, Sweep, parse_sweep
from experiments.sweep.executors import Executor, Future
from experiments.sweep.member import INTERRUPTED, REFUSED, TUNE, Job, Outcome, result_of, run_member

ATTEMPTS: Final = 2
POLL: Final = 0.2  # s
COMMAND: Final = "sweep"


@dataclass(frozen=True)
class Extra:
    """Words for every member that do not stand in the sweep: they change its speed, or run as code."""

    devices: int
    effects: tuple[Path, ...] = ()
    program: tuple[str, ...] = TUNE

    def words(self) -> tuple[str, ...]:
        return (f"--devices={self.devices}", *(f"--effects={path.absolute()}" for path in self.effects))


def settings_of(sweep: Sweep) -> dict[str, Any]:
    """What decides the sweep's results, for its run folder."""
    return {"sweep": sweep.model_dump(mode="json", exclude={"about"})}


def sweep_in(folder: Path) -> Sweep:
    """The sweep that a folder holds. Raises UserError."""
    record = read_json(folder / RUN_FILE, 2 * MAX_BYTES) if (folder / RUN_FILE).exists() else None
    if not isinstance(record, dict) or record.get("command") != COMMAND or not isinstance(record.get("settings"), dict):
        raise UserError(f"{shown(folder)} holds no sweep; give a sweep file or the folder of a sweep.")
    return parse_sweep(record["settings"].get("sweep"), shown(folder / RUN_FILE))


def prepare(folder: Path) -> None:
    """The sweep's own folders. Raises UserError."""
    for name in (MEMBERS, OUTCOMES, LOGS):
        try:
            (folder / name).mkdir(exist_ok=True)
        except OSError as error:
            raise UserError(f"{shown(folder / name)} cannot be made: {error.strerror}; make room for it.") from None


def unfinished(folder: Path, members: Sequence[Member]) -> tuple[list[Member], dict[str, str]]:
    """The members that are still to be run, and those (by name, with the reason) whose results are damaged."""
    todo, damaged = [], {}
    for member in members:
        try:
            if result_of(folder, member.name) is None:
                todo.append(member)
        except UserError as error:
            damaged[member.name] = f"{error} Delete {folder / MEMBERS / member.name} to run it again."
    return todo, damaged


def job_of(folder: Path, sweep: Sweep, member: Member, extra: Extra, attempt: int = 1) -> Job:
    """One attempt at a member."""
    words = (*sweep.tune_arguments(member), *extra.words())
    return Job(str(folder.absolute()), member.name, words, attempt, extra.program)


def run_all(
    folder: Path, sweep: Sweep, todo: Sequence[Member], extra: Extra, executor: Executor, tell: Callable
) -> dict[str, str]:
    """Run the members; the failed ones by name with the reason. `tell(outcome, final)` after every attempt.

    At most two attempts each; bad input is not tried twice. Raises KeyboardInterrupt.
    """
    failed: dict[str, str] = {}
    waiting: dict[str, tuple[Member, int, Future]] = {}

    def submit(member: Member, attempt: int) -> None:
        future = executor.submit(run_member, job_of(folder, sweep, member, extra, attempt))
        waiting[member.name] = (member, attempt, future)

    for member in todo:
        submit(member, 1)
    while waiting:
        ended = [entry for entry in waiting.values() if entry[2].done()]
        for member, attempt, future in ended:
            del waiting[member.name]
            outcome = _outcome(future, member, attempt, folder)
            again = outcome.exit_code not in (0, REFUSED) and attempt < ATTEMPTS
            if again:
                submit(member, attempt + 1)
            elif outcome.exit_code != 0:
                failed[member.name] = outcome.sentence
            tell(outcome, not again)
        if not ended:
            time.sleep(POLL)
    return failed


def _outcome(future: Future, member: Member, attempt: int, folder: Path) -> Outcome:
    """How an attempt ended, also where the executor lost it."""
    try:
        outcome = future.result()
    except Exception as error:  # whatever an executor raises when a worker or a job died
        first = (str(error).strip().splitlines() or [""])[0]
        lost = f"its worker was lost ({shown(type(error).__name__ + (': ' + first if first else ''))})"
        outcome = Outcome(member.name, -1, lost, attempt, 0.0)
    if outcome.exit_code == 0:
        with contextlib.suppress(UserError):
            if result_of(folder, member.name) is None:
                return Outcome(member.name, 1, "it ended without a result", attempt, outcome.seconds)
    if outcome.exit_code == INTERRUPTED:
        return Outcome(member.name, INTERRUPTED, "it was interrupted", attempt, outcome.seconds)
    return outcome


def array_script(folder: Path, sweep: Sweep, extra: Extra, hours: float) -> str:
    """A batch script for `sbatch`, one array task per member."""
    minutes = max(1, round(60 * hours))
    own = folder.absolute()
    command = [sys.executable, "-m", "experiments.cli.main", "sweep", str(own), f"--devices={extra.devices}"]
    command += [f"--effects={path.absolute()}" for path in extra.effects]
    return "\n".join(
        [
            "#!/bin/sh",
            "#SBATCH --job-name=starleth",
            f"#SBATCH --array=0-{sweep.count - 1}",
            f"#SBATCH --cpus-per-task={extra.devices}",
            f"#SBATCH --time={minutes}",
            "#SBATCH --output=/dev/null",
            "#SBATCH --requeue",
            "# killed or requeued tasks go on where they were; finished members are not run again",
            f'log={shlex.quote(str(own / LOGS))}/task_"$SLURM_ARRAY_TASK_ID".log',
            f'exec {shlex.join(command)} --only "$SLURM_ARRAY_TASK_ID" >>"$log" 2>&1',
            "",
        ]
    )
