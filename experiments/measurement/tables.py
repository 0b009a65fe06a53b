"""Columns of numbers out of CSV, Parquet and NPZ files that may come from anybody: no pickle, bounded memory."""

import csv
import gzip
import io
import json
import lzma
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final, NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
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

_CSV_BLOCK: Final = 1 << 22
# what zipfile, its decompressors and NumPy's parser of headers raise
_BAD_NPZ: Final = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, OSError, EOFError, ValueError, NotImplementedError),
    *(RuntimeError, MemoryError, struct.error, tokenize.TokenError, SyntaxError, OverflowError),
)
_EXPLAINED_BYTES: Final = 1 << 26  # how far the slow search for a damaged row goes
# what spreadsheets and pandas write for 'no value', beside the empty cell
OTHER_DELIMITERS: Final = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars"}
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
            _check_cells(cells, name, limits)
            blocks.append(block)
    except (pa.ArrowException, OSError, EOFError, zlib.error) as error:
        _explain_csv(data, name, zipped, delimiter, len(header), error)
    if not blocks:
        return {column: np.empty(0) for column in header}
    table = pa.concat_tables(blocks)
    return {column: _to_float(table.column(column), name, column) for column in header}


def read_parquet(data: bytes, name: str, limits: Limits = LIMITS) -> Columns:
    """All columns of a flat Parquet file as float64, NaN where a value is null."""
    try:
        file = pa.parquet.ParquetFile(
            pa.BufferReader(data),
            thrift_string_size_limit=limits.header_bytes * 16,
            thrift_container_size_limit=limits.columns * 100,
        )
        schema = file.schema_arrow
        names = _check_names(schema.names, name, limits)
        _check_cells(file.metadata.num_rows * len(names), name, limits)
        groups = (file.metadata.row_group(group) for group in range(file.metadata.num_row_groups))
        if sum(group.total_byte_size for group in groups) > limits.unpacked_bytes:
            _too_large(name, limits)
        return {
            column: _to_float(file.read(columns=[column], use_threads=False).column(0), name, column)
            for column in names
        }
    except (pa.ArrowException, OSError, MemoryError, OverflowError, UnicodeDecodeError) as error:
        raise UserError(f"{name} is not a readable Parquet file ({_brief(error)}).") from None


def read_npz(data: bytes, name: str, limits: Limits = LIMITS) -> Columns:
    """All one-dimensional arrays of an NPZ archive as float64; pickled objects are refused."""
    columns: Columns = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            names = _check_names([_array_name(member.filename) for member in members], name, limits)
            if sum(member.file_size for member in members) > limits.unpacked_bytes:
                _too_large(name, limits)
            cells = 0
            for member, column in zip(members, names, strict=True):
                with archive.open(member) as stream:
                    columns[column] = _npy(stream, member.file_size, name, column)
                cells += columns[column].size
                _check_cells(cells, name, limits)
    except _BAD_NPZ as error:
        raise UserError(f"{name} is not a readable NPZ file ({_brief(error)}).") from None
    return columns


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
        raise UserError(f"{name} is not a readable CSV file ({_brief(error)}).") from None
    if len(line) == limits.header_bytes:
        raise UserError(f"{name} has no header line within its first {limits.header_bytes} characters.")
    try:
        row = next(csv.reader([line], delimiter=delimiter, strict=True), [])
    except csv.Error as error:
        raise UserError(f"{name}: the header line cannot be read ({_brief(error)}).") from None
    other = next((mark for mark in OTHER_DELIMITERS if len(row) == 1 and mark in line), None)
    if other is not None:
        raise UserError(
            f"{name} has a single column; if {OTHER_DELIMITERS[other]} stand between its columns, say "
            f"delimiter = {json.dumps(other)} in a column map."
        )
    if row and all(_is_number(cell) for cell in row) and any(cell.strip() for cell in row):
        raise UserError(f"{name} has no header line: its first line holds numbers; write the columns' names there.")
    return _check_names([column.strip() for column in row], name, limits)


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
    raise UserError(f"{name} is not a readable CSV file ({_brief(error)}).") from None


def _is_number(cell: str) -> bool:
    if cell.strip() in _NO_VALUE:
        return True
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # Python's own 1_000


def _npy(stream: io.BufferedIOBase, size: int, name: str, column: str) -> NDArray[np.float64]:
    version = np.lib.format.read_magic(stream)
    read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in read_header:
        raise ValueError(f"array format {version}")
    shape, _, dtype = read_header[version](stream)
    if dtype.kind not in "fiub" or dtype.itemsize > 8 or len(shape) != 1:
        raise UserError(f"{name}: {shown(column)} is no array of numbers over time ({dtype}, shape {shape}).")
    # the size declared in the directory bounds the header's claim before anything is allocated
    if shape[0] < 0 or shape[0] * dtype.itemsize > size:
        raise ValueError(f"{shown(column)} is shorter than its header says")
    content = stream.read(shape[0] * dtype.itemsize)
    return np.frombuffer(content, dtype, count=shape[0]).astype(np.float64)


def _array_name(member: str) -> str:
    return member.removesuffix(".npy")


def _to_float(column: pa.ChunkedArray, name: str, label: str) -> NDArray[np.float64]:
    kind = column.type
    if pa.types.is_null(kind):  # nothing but empty cells
        return np.full(len(column), np.nan)
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)):
        raise UserError(f"{name}: column {shown(label)} holds {shown(str(kind))} where numbers are expected.")
    if pa.types.is_boolean(kind):
        column = column.cast(pa.uint8())
    return np.asarray(column.cast(pa.float64(), safe=False).to_numpy(), dtype=np.float64)


def _check_names(names: Iterable[str], name: str, limits: Limits) -> list[str]:
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


def _check_cells(cells: int, name: str, limits: Limits) -> None:
    if cells > limits.cells:
        raise UserError(f"{name} holds more than the {limits.cells} values that are read; cut the log into parts.")


def _too_large(name: str, limits: Limits) -> NoReturn:
    raise UserError(f"{name} unpacks to more than the {limits.unpacked_bytes} bytes that are read; cut the log.")


def _brief(error: Exception) -> str:
    text = shown(" ".join(str(error).split()) or type(error).__name__)
    return text if len(text) <= 120 else text[:119] + "…"
