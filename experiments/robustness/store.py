"""The finished trials of a robustness analysis on disk: blocks that are whole, or computed again.

    trials/00000512-3f…a1.parquet    512 trials from index 512 on; the name ends in the SHA-256 of what is inside

Any Parquet reader opens the folder as one table: `trial`, `drawn.<name>` for every number drawn, `cost`, metrics.
"""

import hashlib
import io
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from experiments.errors import UserError
from experiments.files import read_bytes, shown, write_bytes

BLOCK = 512  # trials in a file: seconds of work that a kill may cost
MAX_BYTES = 16 * 2**20
FOLDER = "trials"
NAME = re.compile(r"^(\d{10})-([0-9a-f]{32})\.parquet$")
DRAWN = "drawn."

Table = dict[str, np.ndarray]  # columns (N,) by name


class TrialStore:
    """The blocks of one run's folder, which the caller holds."""

    def __init__(self, folder: Path, notify: Callable[[str], None]) -> None:
        self.folder = folder / FOLDER
        self.notify = notify
        try:
            self.folder.mkdir(exist_ok=True)
        except OSError as error:
            raise UserError(f"{shown(self.folder)} cannot be made: {error.strerror}; give another folder.") from None

    def get(self, first: int, count: int, columns: tuple[str, ...]) -> Table | None:
        """The block that begins with trial `first`, cut to `count`; None if it is missing, short or damaged."""
        for path in sorted(self.folder.glob(f"{first:010d}-*.parquet")):
            table = _read(path, columns)
            if table is None:
                self.notify(f"{path} is damaged; its trials are computed again.")
                path.unlink(missing_ok=True)
            elif len(table["trial"]) >= count:
                return {name: values[:count] for name, values in table.items()}
        return None

    def put(self, first: int, table: Table) -> None:
        """Write a block atomically, then remove what it replaces. Raises UserError (full disk)."""
        buffer = io.BytesIO()
        pq.write_table(pa.table(table), buffer)
        data = buffer.getvalue()
        path = self.folder / f"{first:010d}-{hashlib.sha256(data).hexdigest()[:32]}.parquet"
        write_bytes(path, data)
        for old in self.folder.glob(f"{first:010d}-*.parquet"):
            if old != path:
                old.unlink(missing_ok=True)


def _read(path: Path, columns: tuple[str, ...]) -> Table | None:
    found = NAME.match(path.name)
    try:
        data = read_bytes(path, MAX_BYTES)
    except UserError:
        return None
    if not found or hashlib.sha256(data).hexdigest()[:32] != found.group(2):
        return None
    try:
        table = pq.read_table(io.BytesIO(data))
    except (pa.ArrowException, OSError):
        return None
    if tuple(table.column_names) != columns:
        return None
    return {name: table[name].to_numpy() for name in columns}


def blocks(trials: int) -> Iterator[tuple[int, int]]:
    """First index and size of each block of so many trials."""
    for first in range(0, trials, BLOCK):
        yield first, min(BLOCK, trials - first)
