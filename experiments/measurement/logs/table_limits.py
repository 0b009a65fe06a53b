"""How much of a table is read at most, and what its columns must be, whatever its format."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NoReturn

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from experiments.errors import UserError
from experiments.files import shown


@dataclass(frozen=True)
class Limits:
    """What is read at most; ten minutes of all signals at 400 Hz are 26 million cells and 300 MB of CSV."""

    file_bytes: int = 1 << 29
    unpacked_bytes: int = 1 << 30
    columns: int = 1000
    cells: int = 50_000_000
    header_bytes: int = 1 << 17


LIMITS: Final = Limits()
Columns = dict[str, NDArray[np.float64]]


def to_float(column: pa.ChunkedArray, name: str, label: str) -> NDArray[np.float64]:
    kind = column.type
    if pa.types.is_null(kind):  # nothing but empty cells
        return np.full(len(column), np.nan)
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)):
        raise UserError(f"{name}: column {shown(label)} holds {shown(str(kind))} where numbers are expected.")
    if pa.types.is_boolean(kind):
        column = column.cast(pa.uint8())
    return np.asarray(column.cast(pa.float64(), safe=False).to_numpy(), dtype=np.float64)


def check_names(names: Iterable[str], name: str, limits: Limits) -> list[str]:
    found = list(names)
    if not found or found == [""]:
        raise UserError(f"{name} is empty; a log has a header line that starts with 'time' and a row for each sample.")
    if len(found) > limits.columns:
        raise UserError(f"{name} has {len(found)} columns, more than the {limits.columns} that are read.")
    seen: set[str] = set()
    for column in found:
        if column in seen:
            raise UserError(f"{name} has the column '{shown(column)}' twice; rename or delete one of them.")
        seen.add(column)
    return found


def check_cells(cells: int, name: str, limits: Limits) -> None:
    if cells > limits.cells:
        raise UserError(f"{name} holds more than the {limits.cells} values that are read; cut the log into parts.")


def too_large(name: str, limits: Limits) -> NoReturn:
    raise UserError(f"{name} unpacks to more than the {limits.unpacked_bytes} bytes that are read; cut the log.")


def brief(error: Exception) -> str:
    text = shown(" ".join(str(error).split()) or type(error).__name__)
    return text if len(text) <= 120 else text[:119] + "…"
