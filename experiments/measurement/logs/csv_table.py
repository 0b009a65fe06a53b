"""Columns of numbers out of CSV files that may come from anybody: bounded memory, the damaged row named."""

import csv
import gzip
import io
import json
import zlib
from collections.abc import Iterator
from typing import Final, NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.csv

from experiments.errors import UserError
from experiments.files import shown
from experiments.measurement.logs.table_limits import (
    LIMITS,
    Columns,
    Limits,
    brief,
    check_cells,
    check_names,
    to_float,
)

_CSV_BLOCK: Final = 1 << 22
_EXPLAINED_BYTES: Final = 1 << 26  # how far the slow search for a damaged row goes
OTHER_DELIMITERS: Final = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars"}
# what spreadsheets and pandas write for 'no value', beside the empty cell
_NO_VALUE: Final = ["", "nan", "NaN", "NAN", "NA", "null"]


def read_csv(data: bytes, name: str, zipped: bool, delimiter: str = ",", limits: Limits = LIMITS) -> Columns:
    """All columns of a CSV with one header line as float64, NaN where a cell is empty."""
    _refuse_other_kind(data, name, zipped)
    header = _csv_header(data, name, zipped, delimiter, limits)
    cells = 0
    blocks: list[pa.Table] = []
    # block by block in this thread: Arrow's own streaming reads ahead in one that calls back into Python, also at exit
    try:
        for text in _csv_blocks(data, name, zipped, limits):
            block = pa.csv.read_csv(
                pa.BufferReader(text),
                read_options=pa.csv.ReadOptions(use_threads=False, column_names=header),
                parse_options=pa.csv.ParseOptions(delimiter=delimiter, newlines_in_values=False),
                convert_options=pa.csv.ConvertOptions(
                    column_types=dict.fromkeys(header, pa.float64()), null_values=_NO_VALUE
                ),
            )
            cells += block.num_rows * len(header)
            check_cells(cells, name, limits)
            blocks.append(block)
    except (pa.ArrowException, OSError, EOFError, zlib.error) as error:
        _explain_csv(data, name, zipped, delimiter, len(header), error)
    if not blocks:
        return {column: np.empty(0) for column in header}
    table = pa.concat_tables(blocks)
    return {column: to_float(table.column(column), name, column) for column in header}


class _Capped(io.RawIOBase):
    """The bytes of a file, unpacked on the way; more than `most` of them are refused, so that a bomb stays small."""

    def __init__(self, data: bytes, zipped: bool, most: int):
        self._stream = gzip.GzipFile(fileobj=io.BytesIO(data)) if zipped else io.BytesIO(data)
        self._left = most

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:
        part = self._stream.read(len(buffer))
        self._left -= len(part)
        if self._left < 0:
            raise OSError("it unpacks to more bytes than are read")
        buffer[: len(part)] = part
        return len(part)


def _refuse_other_kind(data: bytes, name: str, zipped: bool) -> None:
    """Files that are no CSV by their first bytes, named for what they are."""
    gzipped = data.startswith(b"\x1f\x8b")
    if data and gzipped != zipped:
        what, ending = ("is gzipped", ".csv.gz") if gzipped else ("is not gzipped", ".csv")
        raise UserError(f"{name} {what}; give it a name that ends in {ending}, if it is a log.")
    if data.startswith(b"PK"):
        raise UserError(f"{name} is a zip archive or a spreadsheet, no CSV; export it as one.")


def _lines(data: bytes, zipped: bool, most: int) -> io.TextIOWrapper:
    raw = io.BufferedReader(_Capped(data, zipped, most))
    return io.TextIOWrapper(raw, encoding="utf-8-sig", newline="")


def _csv_header(data: bytes, name: str, zipped: bool, delimiter: str, limits: Limits) -> list[str]:
    """The names of the columns."""
    try:
        lines = _lines(data, zipped, limits.unpacked_bytes)
        line = lines.readline(limits.header_bytes)
    except UnicodeDecodeError:
        raise UserError(f"{name} is no text in UTF-8 but in another encoding, or binary; save it as UTF-8.") from None
    except (OSError, EOFError, zlib.error) as error:
        raise UserError(f"{name} is not a readable CSV file ({brief(error)}).") from None
    if len(line) == limits.header_bytes:
        raise UserError(f"{name} has no header line within its first {limits.header_bytes} characters.")
    try:
        row = next(csv.reader([line], delimiter=delimiter, strict=True), [])
    except csv.Error as error:
        raise UserError(f"{name}: the header line cannot be read ({brief(error)}).") from None
    other = next((mark for mark in OTHER_DELIMITERS if len(row) == 1 and mark in line), None)
    if other is not None:
        raise UserError(
            f"{name} has a single column; if {OTHER_DELIMITERS[other]} stand between its columns, say "
            f"delimiter = {json.dumps(other)} in a column map."
        )
    if row and all(_is_number(cell) for cell in row) and any(cell.strip() for cell in row):
        raise UserError(f"{name} has no header line: its first line holds numbers; write the columns' names there.")
    return check_names([column.strip() for column in row], name, limits)


def _csv_blocks(data: bytes, name: str, zipped: bool, limits: Limits) -> Iterator[bytes]:
    """The rows after the header, in blocks of whole lines."""
    stream = _Capped(data, zipped, limits.unpacked_bytes)
    rest, in_header = b"", True
    while part := stream.read(_CSV_BLOCK):
        block = rest + part
        if in_header:
            end = min((at for at in (block.find(b"\n"), block.find(b"\r")) if at >= 0), default=len(block))
            block, in_header = block[end:], False
        end = max(block.rfind(b"\n"), block.rfind(b"\r")) + 1
        rest = block[end:]
        if len(rest) > _CSV_BLOCK:
            raise UserError(f"{name} has a line of more than {_CSV_BLOCK} bytes, which no log has.")
        if block[:end].strip(b"\r\n"):
            yield block[:end]
    if rest:
        yield rest


def _explain_csv(data: bytes, name: str, zipped: bool, delimiter: str, width: int, error: Exception) -> NoReturn:
    """Find the first row that is wrong, which Arrow does not always tell, and name it."""
    try:
        rows = csv.reader(_lines(data, zipped, _EXPLAINED_BYTES), delimiter=delimiter)
        header = next(rows)
        for number, row in enumerate(rows, start=2):
            if not row:
                continue
            if len(row) != width:
                raise UserError(
                    f"{name}: line {number} has {len(row)} columns where the header has {width}; "
                    "the file is damaged or uses another delimiter."
                )
            for column, cell in zip(header, row, strict=True):
                if not _is_number(cell):
                    raise UserError(
                        f"{name}: line {number}, column {shown(column)}: '{shown(cell)}' is not a number; "
                        "leave the cell empty where there is no value."
                    )
    except (OSError, EOFError, zlib.error, ValueError, csv.Error) as later:
        error = later
    raise UserError(f"{name} is not a readable CSV file ({brief(error)}).") from None


def _is_number(cell: str) -> bool:
    if cell.strip() in _NO_VALUE:
        return True
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # Python's own 1_000
