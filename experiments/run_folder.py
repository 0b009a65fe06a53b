"""The folder of one run: used by one process at a time, never mixed with anything else, and resumable.

    runs/jump/
      run.json   what the run is: its command, the settings that decide its result, has it finished
      .lock      held (flock) by the process that works here; the kernel drops it when that process dies
      …          the run's own files

The lock is the kernel's, not the file's: what a SIGKILL leaves behind is a file that nobody holds, and the
next run takes it over. Its contents only serve the message.
"""

import errno
import fcntl
import json
import os
import shutil
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from experiments.errors import UserError
from experiments.files import TEMPORARY_NAME, read_json, refuse_unwritable, shown, write_json

SCHEMA_VERSION: Final = 1
RUN_FILE: Final = "run.json"
LOCK_FILE: Final = ".lock"
MAX_BYTES: Final = 1_000_000
MIN_FREE_BYTES: Final = 64 * 2**20  # a whole run leaves less: checkpoints, motion, report


@dataclass(frozen=True)
class RunFolder:
    """An output folder that this process holds."""

    path: Path
    command: str  # the subcommand that fills it: tune, robustness, …
    settings: dict[str, Any] = field(hash=False)  # what decides the result, as JSON
    resumed: bool = False  # an earlier process began this run
    finished: bool = False  # …and ended it

    def __truediv__(self, name: str) -> Path:
        return self.path / name

    def mark_finished(self) -> None:
        """Say that nothing is left to do. Raises UserError when the disk is full."""
        _write_record(self.path, self.command, self.settings, finished=True)


@contextmanager
def open_run(
    path: Path | str,
    command: str,
    settings: Mapping[str, Any],
    *,
    may_differ: tuple[str, ...] = (),
) -> Iterator[RunFolder]:
    """Hold the folder `path` for one run of `command` as long as the context lasts.

    A folder that does not exist or is empty begins a new run. A folder of the same command and settings (up
    to the names in `may_differ`, say the number of devices) is resumed. Everything else is refused with a
    UserError: a folder another process is working in, one that holds other files, another command's or
    other settings' run, a damaged record, a place where nothing can be written, a disk with hardly any
    room.
    """
    folder = Path(path)
    wanted = json.loads(json.dumps(dict(settings), allow_nan=False))  # what a resumed run will read back
    _make(folder)
    _refuse_unrelated(folder)
    with _locked(folder):
        _refuse_unrelated(folder)  # again: now nobody else can be at work in it
        _remove_temporaries(folder)
        if shutil.disk_usage(folder).free < MIN_FREE_BYTES:
            raise UserError(
                f"the disk of {shown(folder)} is almost full (a run needs {MIN_FREE_BYTES // 2**20} MB); make room."
            )
        record = _read_record(folder)
        if record is not None:
            _refuse_other(folder, record, command, wanted, may_differ)
        finished = record is not None and record["finished"]
        run = RunFolder(folder, command, wanted, resumed=record is not None, finished=finished)
        if not finished:
            _write_record(folder, command, wanted, finished=False)
        yield run


def make_answer_folder(path: Path | str) -> None:
    """A folder for an answer that is no run of its own, made before the work. Raises UserError.

    The folder of a run is refused: its report would be overwritten.
    """
    folder = Path(path)
    _make(folder)
    refuse_unwritable(folder / "report.html")
    if (folder / RUN_FILE).exists():
        raise UserError(f"{shown(folder)} holds a run, whose report would be lost; give another output folder.")


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise UserError(f"{shown(folder)} is not a folder; give another output folder.") from None
    except (OSError, ValueError) as error:
        reason = (getattr(error, "strerror", None) or str(error)).lower()
        raise UserError(f"cannot make the folder {shown(folder)}: {reason}; give another output folder.") from None


def _foreign(folder: Path) -> list[str]:
    return sorted(
        entry.name
        for entry in folder.iterdir()
        if entry.name not in (RUN_FILE, LOCK_FILE) and not TEMPORARY_NAME.match(entry.name)
    )


def _refuse_unrelated(folder: Path) -> None:
    try:
        others = [] if (folder / RUN_FILE).exists() else _foreign(folder)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise UserError(f"cannot read the folder {shown(folder)}: {reason}; give another output folder.") from None
    if others:
        raise UserError(
            f"{shown(folder)} holds other files ({shown(others[0])}{', …' if len(others) > 1 else ''}) "
            "and no run; give a new or empty output folder."
        )


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    try:
        descriptor = os.open(folder / LOCK_FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise UserError(f"cannot write into {shown(folder)}: {reason}; give another output folder.") from None
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                holder = os.pread(descriptor, 200, 0).decode(errors="replace").strip()
                by = f" (by {shown(holder)})" if holder else ""
                raise UserError(
                    f"{shown(folder)} is in use by another run{by}; wait for it, stop it, or give another folder."
                ) from None
            raise UserError(
                f"the file system of {shown(folder)} cannot lock files, so two runs could spoil each other; "
                "give a folder on a local disk."
            ) from None
        with suppress(OSError):  # a full disk is told by the record's write
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode(), 0)
        yield
    finally:
        os.close(descriptor)


def _remove_temporaries(folder: Path) -> None:
    """What writes cut off by a kill left behind."""
    for entry in folder.iterdir():
        if TEMPORARY_NAME.match(entry.name):
            with suppress(OSError):
                entry.unlink()


def _write_record(folder: Path, command: str, settings: dict[str, Any], *, finished: bool) -> None:
    record = {
        "schema_version": SCHEMA_VERSION,
        "command": command,
        "settings": settings,
        "finished": finished,
    }
    write_json(folder / RUN_FILE, record)


def _read_record(folder: Path) -> dict[str, Any] | None:
    if not (folder / RUN_FILE).exists():
        return None
    record = read_json(folder / RUN_FILE, MAX_BYTES)
    kinds = {"schema_version": int, "command": str, "settings": dict, "finished": bool}
    if not isinstance(record, dict) or any(type(record.get(name)) is not kind for name, kind in kinds.items()):
        raise UserError(f"{shown(folder / RUN_FILE)} is damaged; give a new output folder.")
    return record


def _refuse_other(
    folder: Path, record: dict[str, Any], command: str, settings: dict[str, Any], may_differ: tuple[str, ...]
) -> None:
    if record["schema_version"] != SCHEMA_VERSION:
        raise UserError(
            f"{shown(folder)} holds a run of another version (schema {record['schema_version']}, this "
            f"program has {SCHEMA_VERSION}); give a new output folder."
        )
    if record["command"] != command:
        raise UserError(
            f"{shown(folder)} holds a run of '{shown(record['command'])}', not of '{command}'; "
            "give a new output folder."
        )
    before = {name: value for name, value in record["settings"].items() if name not in may_differ}
    different = _difference(before, {name: value for name, value in settings.items() if name not in may_differ})
    if different is not None:
        name, then, now = different
        raise UserError(
            f"{shown(folder)} holds a run with other settings ({shown(name)} was {shown(then)}, now {shown(now)}); "
            "repeat the old settings to resume it, or give a new output folder."
        )


def _difference(before: Any, now: Any, name: str = "") -> tuple[str, str, str] | None:
    """Name and both values of the first number, text or list in which two settings differ."""
    if isinstance(before, dict) and isinstance(now, dict):
        below = (
            _difference(before.get(key), now.get(key), f"{name}.{key}" if name else key)
            for key in sorted(before.keys() | now.keys())
        )
        return next((found for found in below if found is not None), None)
    if isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        below = (_difference(*pair, f"{name}.{i}") for i, pair in enumerate(zip(before, now, strict=True)))
        return next((found for found in below if found is not None), None)
    return None if before == now else (name, str(before), str(now))
