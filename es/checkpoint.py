"""The checkpoints of a search: they survive a kill at any moment and never lie about it.

A checkpoint is a folder `generation_00000123` (checkpoint_files.py). It is written under a hidden name, synced to the
disk and renamed: a folder with the final name is whole unless the disk damaged it later. Then the newest checkpoint
that is whole is used, and the others are named.
"""

import json
import os
import shutil
import time
import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import Any

import jax
import numpy as np

from es.checkpoint_files import Damaged, first_line, read_arrays, read_manifest, sync, write_checkpoint

PREFIX, WRITING, DELETING = "generation_", ".writing_", ".deleting_"


class CheckpointError(ValueError):
    """A checkpoint that cannot be written or used; the message is one sentence that says which and why."""


class Checkpointer:
    """The checkpoints of one search in one folder, which no other process may write at the same time.

    `identity` is what the search itself does not know but what must be the same when it is resumed: task, model hash,
    number of trials, ... (JSON values). `notify` gets one sentence for each damaged checkpoint that was passed over.
    A checkpoint costs 35 ms on a quiet machine and more on a busy disk, so one is made only when the last is
    `seconds_between` old: work lost by a kill is computed again, to the same bits. In a run of several processes only
    the first writes.
    """

    def __init__(
        self,
        directory: str | os.PathLike[str],
        identity: Mapping[str, Any] | None = None,
        *,
        keep: int = 3,
        seconds_between: float = 5.0,
        notify: Callable[[str], None] = warnings.warn,
    ) -> None:
        self.directory = Path(directory).absolute()
        self._identity = dict(identity or {})
        self._keep = keep
        self._seconds_between = seconds_between
        self._notify = notify
        self._fingerprint: dict[str, Any] = {}
        self._saved, self._saved_at = -1, -np.inf
        self._lock = Lock()

    def open(self, search: Mapping[str, Any]) -> None:
        """Make the folder and fix the fingerprint: the caller's identity and the description of the search."""
        self._fingerprint = _plain({"identity": self._identity, "search": dict(search)})
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CheckpointError(f"the folder {self.directory} cannot be used: {error.strerror}") from None

    def due(self) -> bool:
        """Whether the last checkpoint is old enough for another."""
        return time.monotonic() - self._saved_at >= self._seconds_between

    def save(self, generation: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Write the checkpoint of `generation` atomically and drop all but the last few. Raises CheckpointError.

        Done in a thread of its own, which a KeyboardInterrupt does not touch: orbax's threads would write on without
        it. The lock is for the next save, should the interrupt have come before this one could be waited for.
        """
        if jax.process_index() != 0:
            return
        with ThreadPoolExecutor(1) as thread:
            thread.submit(self._save, generation, arrays).result()

    def _save(self, generation: int, arrays: Mapping[str, np.ndarray]) -> None:
        final = self.directory / f"{PREFIX}{generation:08d}"
        with self._lock:
            if generation == self._saved:
                return
            try:
                self._write(generation, arrays, final)
            except OSError as error:
                reason = error.strerror or type(error).__name__
                raise CheckpointError(f"the checkpoint {final} cannot be written: {reason}") from None
            except (ValueError, RuntimeError) as error:  # what tensorstore makes of the file system's errors
                raise CheckpointError(f"the checkpoint {final} cannot be written: {first_line(error)}") from None
            self._saved, self._saved_at = generation, time.monotonic()

    def _write(self, generation: int, arrays: Mapping[str, np.ndarray], final: Path) -> None:
        self._remove_leftovers()
        writing = self.directory / f"{WRITING}{generation:08d}"
        writing.mkdir()
        write_checkpoint(writing, arrays, self._fingerprint)
        self._drop(later_than=generation - 1)  # damaged ones that this search has passed over
        writing.rename(final)
        sync(self.directory)
        self._drop(all_but=self._keep)

    def load(self) -> dict[str, np.ndarray] | None:
        """The arrays of the newest whole checkpoint, or None if the folder has no checkpoint at all.

        Raises CheckpointError if it belongs to another search, or if there are checkpoints but none is whole.
        """
        damaged = []
        for folder in reversed(self._folders()):
            try:
                fingerprint = read_manifest(folder)
                self._check_fingerprint(folder, fingerprint)
                arrays = read_arrays(folder)
            except Damaged as damage:
                damaged.append(f"checkpoint {folder} is damaged ({damage})")
                continue
            for sentence in damaged:
                self._notify(f"{sentence}; going on from {folder.name}")
            self._saved = int(folder.name[len(PREFIX) :])
            return arrays
        if damaged:
            raise CheckpointError(f"no usable checkpoint is left: {'; '.join(damaged)}; start again in a new folder")
        return None

    def _folders(self) -> list[Path]:
        """Checkpoint folders, oldest first."""
        named = (path for path in self.directory.glob(f"{PREFIX}*") if path.name[len(PREFIX) :].isdecimal())
        return sorted(named, key=lambda path: int(path.name[len(PREFIX) :]))

    def _check_fingerprint(self, folder: Path, fingerprint: Any) -> None:
        difference = _first_difference(fingerprint, self._fingerprint)
        if difference is not None:
            raise CheckpointError(
                f"the checkpoint {folder} belongs to another search ({difference}); "
                "use the settings it was made with, or a new folder"
            )

    def _drop(self, *, later_than: int | None = None, all_but: int | None = None) -> None:
        """Delete checkpoints; renamed first, so that a kill leaves no half-deleted one behind."""
        folders = self._folders()
        if later_than is not None:
            folders = [folder for folder in folders if int(folder.name[len(PREFIX) :]) > later_than]
        if all_but is not None:
            folders = folders[:-all_but]
        for folder in folders:
            condemned = folder.with_name(f"{DELETING}{folder.name[len(PREFIX) :]}")
            folder.rename(condemned)
            shutil.rmtree(condemned)

    def _remove_leftovers(self) -> None:
        """What a killed process was writing or deleting."""
        for prefix in (WRITING, DELETING):
            for path in self.directory.glob(f"{prefix}*"):
                shutil.rmtree(path)


def _plain(value: Any) -> Any:
    """As it comes back from JSON; ValueError if it is not JSON."""
    try:
        return json.loads(json.dumps(value, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise ValueError(f"the identity of a search must be JSON values: {error}") from None


def _first_difference(there: Any, here: Any, path: str = "") -> str | None:
    """The first leaf in which two JSON values differ, in words, or None."""
    if isinstance(there, dict) and isinstance(here, dict):
        for name in sorted(there.keys() | here.keys()):
            inner = f"{path}.{name}" if path else name
            difference = _first_difference(there.get(name), here.get(name), inner)
            if difference is not None:
                return difference
        return None
    return None if there == here else f"{path} is {_short(there)} there and {_short(here)} here"


def _short(value: Any) -> str:
    text = "missing" if value is None else json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
