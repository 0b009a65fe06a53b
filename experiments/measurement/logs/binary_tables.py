"""Columns of numbers out of Parquet and NPZ files that may come from anybody: no pickle, bounded memory."""

import io
import lzma
import struct
import tokenize
import zipfile
import zlib
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet
from numpy.typing import NDArray

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
    too_large,
)

# what zipfile, its decompressors and NumPy's parser of headers raise
_BAD_NPZ: Final = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, OSError, EOFError, ValueError, NotImplementedError),
    *(RuntimeError, MemoryError, struct.error, tokenize.TokenError, SyntaxError, OverflowError),
)


def read_parquet(data: bytes, name: str, limits: Limits = LIMITS) -> Columns:
    """All columns of a flat Parquet file as float64, NaN where a value is null."""
    try:
        file = pa.parquet.ParquetFile(
            pa.BufferReader(data),
            thrift_string_size_limit=limits.header_bytes * 16,
            thrift_container_size_limit=limits.columns * 100,
        )
        schema = file.schema_arrow
        names = check_names(schema.names, name, limits)
        check_cells(file.metadata.num_rows * len(names), name, limits)
        groups = (file.metadata.row_group(group) for group in range(file.metadata.num_row_groups))
        if sum(group.total_byte_size for group in groups) > limits.unpacked_bytes:
            too_large(name, limits)
        return {
            column: to_float(file.read(columns=[column], use_threads=False).column(0), name, column) for column in names
        }
    except (pa.ArrowException, OSError, MemoryError, OverflowError, UnicodeDecodeError) as error:
        raise UserError(f"{name} is not a readable Parquet file ({brief(error)}).") from None


def read_npz(data: bytes, name: str, limits: Limits = LIMITS) -> Columns:
    """All one-dimensional arrays of an NPZ archive as float64; pickled objects are refused."""
    columns: Columns = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            names = check_names([_array_name(member.filename) for member in members], name, limits)
            if sum(member.file_size for member in members) > limits.unpacked_bytes:
                too_large(name, limits)
            cells = 0
            for member, column in zip(members, names, strict=True):
                with archive.open(member) as stream:
                    columns[column] = _npy(stream, member.file_size, name, column)
                cells += columns[column].size
                check_cells(cells, name, limits)
    except _BAD_NPZ as error:
        raise UserError(f"{name} is not a readable NPZ file ({brief(error)}).") from None
    return columns


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
