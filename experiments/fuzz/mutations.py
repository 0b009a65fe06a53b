"""Hostile versions of a good file: torn, flipped, spliced; where the format is known, wrong in a place that counts."""

import copy
import gzip
import io
import json
import random
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from typing import Any, Final

Mutate = Callable[[bytes, random.Random], bytes]

TOKENS: Final = (
    *(b"NaN", b"Infinity", b"-Infinity", b"1e999", b"-1e999", b"1e-999", b"9" * 25, b"0x10", b"1_0", b"-0", b"null"),
    *(b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\n", b"\r\n", b'"', b"'", b",", b";", b"\\ud800", b"\\u0000"),
    *(b"[" * 200, b"{" * 200, b'{"a":' * 100, b"../" * 20, b"A" * 5000, b"%s%n", b"$(id)", b"__import__('os')"),
    *(b"\xf0\x9f\xa4\x96", b"\xc3", b"\xed\xa0\x80", b"true", b"False", b"[]", b"{}", b"=1+1"),
)
VALUES: Final[tuple[Any, ...]] = (
    *(None, True, False, 0, -1, 1, 2**31, 2**53, 2**63, -(2**64), 10**19, 1.5, -0.0, 1e308, 1e-308, 1e30, 5e-324),
    *(float("nan"), float("inf"), -float("inf"), "", "x", "A" * 5000, "../../etc/passwd", "/dev/zero", "\x00", "a\nb"),
    *("\ud800", "é", "1", "NaN", "--effects=evil.py", "0-99999999999", "\x1b[2J", [], {}, [[]], [None], {"": 0}),
    *([0] * 2000, [1e308] * 12, {"a": {"b": {"c": {}}}}, [[[[[[[[]]]]]]]], "all", "torso", "nominal", "__class__"),
)


def damaged(data: bytes, chance: random.Random) -> bytes:
    """One to four damages that need no knowledge of the format."""
    for _ in range(chance.randint(1, 4)):
        size = len(data)
        a, b = sorted((chance.randint(0, size), chance.randint(0, size)))
        kind = chance.randrange(8)
        if kind == 0:
            data = data[:a]
        elif kind == 1 and size:
            at = chance.randrange(size)
            data = data[:at] + bytes([data[at] ^ 1 << chance.randrange(8)]) + data[at + 1 :]
        elif kind == 2:
            data = data[:a] + chance.randbytes(chance.randint(1, 8)) + data[a:]
        elif kind == 3:
            data = data[:a] + data[min(b, a + 200) :]
        elif kind == 4:
            data = data[:b] + data[a : min(b, a + 2000)] + data[b:]
        elif kind == 5:
            data = data[:a] + bytes(min(b - a, 100)) + data[min(b, a + 100) :]
        else:
            data = data[:a] + chance.choice(TOKENS) + data[a + chance.choice((0, 1, 4)) :]
    return data


def hostile_json(data: bytes, chance: random.Random) -> bytes:
    """The same JSON with one to three places that are of another kind, gone, twice there or unknown."""
    content = json.loads(data)
    for _ in range(chance.randint(1, 3)):
        content = _changed(content, chance)
    text = json.dumps(content)
    if chance.random() < 0.1 and text.startswith("{") and len(text) > 2:
        text = "{" + text[1:-1] + "," + text[1:]  # every key twice
    return text.encode()


def _changed(content: Any, chance: random.Random) -> Any:
    content = copy.deepcopy(content)
    places: list[tuple[Any, Any]] = []
    _walk(content, places)
    if not places:
        return chance.choice(VALUES)
    parent, key = chance.choice(places)
    kind = chance.randrange(6)
    if kind == 0:
        del parent[key]
    elif kind == 1 and isinstance(parent, dict):
        parent[chance.choice(("colour", "", "\x00", "__class__", "schema_version", "A" * 300))] = parent[key]
    elif kind == 2 and isinstance(parent, list):
        parent.extend([parent[key]] * chance.choice((1, 3, 1000)))
    elif kind == 3:
        other, name = chance.choice(places)
        if isinstance(other, dict) == (name in other if isinstance(other, dict) else False) or isinstance(other, list):
            parent[key] = copy.deepcopy(other[name]) if _there(other, name) else None
    elif kind == 4 and isinstance(parent[key], float | int) and not isinstance(parent[key], bool):
        parent[key] = parent[key] * chance.choice((-1, 0, 1e-12, 1e12, 1e300))
    else:
        parent[key] = copy.deepcopy(chance.choice(VALUES))
    return content


def _there(parent: Any, key: Any) -> bool:
    return key in parent if isinstance(parent, dict) else key < len(parent)


def _walk(value: Any, places: list[tuple[Any, Any]]) -> None:
    if isinstance(value, dict | list):
        for key in list(value) if isinstance(value, dict) else range(len(value)):
            places.append((value, key))
            _walk(value[key], places)


def json_file(data: bytes, chance: random.Random) -> bytes:
    """A hostile JSON file: wrong in its structure more often than in its bytes."""
    return hostile_json(data, chance) if chance.random() < 0.7 else damaged(data, chance)


def csv_file(data: bytes, chance: random.Random) -> bytes:
    """Cells, names and rows changed, or plain damage."""
    if chance.random() < 0.4:
        return damaged(data, chance)
    lines = [line.split(b",") for line in data.split(b"\n")]
    for _ in range(chance.randint(1, 5)):
        row = chance.choice(lines)
        kind = chance.randrange(5)
        if kind == 0:
            row[chance.randrange(len(row))] = chance.choice(TOKENS)
        elif kind == 1:
            row.append(chance.choice(TOKENS))
        elif kind == 2 and len(row) > 1:
            row.pop(chance.randrange(len(row)))
        elif kind == 3:
            lines.insert(chance.randrange(len(lines) + 1), list(chance.choice(lines)))
        else:
            i, j = chance.randrange(len(row)), chance.randrange(len(row))
            row[i], row[j] = row[j], row[i]
    return b"\n".join(b",".join(row) for row in lines)


def gzip_file(data: bytes, chance: random.Random) -> bytes:
    """`data` is a gzipped CSV: damaged outside, hostile inside, several members, or a bomb."""
    kind = chance.random()
    if kind < 0.4:
        return damaged(data, chance)
    if kind < 0.95:
        return gzip.compress(csv_file(gzip.decompress(data), chance), 1) + chance.choice(
            (b"", b"", data, b"\x1f\x8b", b"x")
        )
    if kind < 0.995:
        return gzip.compress(chance.choice((b"0", b"\n", b",", b"time\n", b"\x00")) * 3_000_000, 1)
    return bomb(chance.choice((b"0", b"1,", b"\n", b"time,a\n1,2\n")))


def bomb(unit: bytes, size: int = 3 << 29) -> bytes:
    """Gzip of 1.5 GB of a repeated unit, more than is read of any file; itself some MB."""
    packer = zlib.compressobj(1, zlib.DEFLATED, 31)
    block = unit * ((1 << 22) // len(unit))
    return b"".join(packer.compress(block) for _ in range(size // len(block))) + packer.flush()


def npz_file(data: bytes, chance: random.Random) -> bytes:
    """Array headers that claim too much, of wrong kinds, pickles; directories that lie; or plain damage."""
    kind = chance.random()
    if kind < 0.4:
        return damaged(data, chance)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    victim = chance.choice(list(members))
    if kind < 0.5:
        members[victim] = damaged(members[victim], chance)
    else:
        members[victim] = npy(chance)
    buffer = io.BytesIO()
    packing = chance.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    with zipfile.ZipFile(buffer, "w", packing) as archive, warnings.catch_warnings(action="ignore"):  # of equal names
        for name, content in members.items():
            archive.writestr(chance.choice((name, name, name, "../x.npy", "/etc/x.npy", "/", "a" * 300)), content)
    packed = buffer.getvalue()
    if kind > 0.85:  # sizes in the directory
        at = packed.find(b"PK\x01\x02")
        field = at + chance.choice((20, 24, 28, 42))
        lie = struct.pack("<I", chance.choice((0, 1, 2**31, 2**32 - 1, chance.randrange(2**20))))
        packed = packed[:field] + lie + packed[field + 4 :]
    return packed


def npy(chance: random.Random) -> bytes:
    """An array file whose header is hostile."""
    descr = chance.choice(
        ("'<f8'", "'|O'", "'<f4'", "'<U9'", "'<f16'", "'<c16'", "[('a','<f8')]", "'<M8[s]'", "'|V9'", "'x'", "1")
    )
    shape = chance.choice(
        (
            "(40,)",
            "()",
            "(0,)",
            "(-1,)",
            "(10**18,)",
            "(1000000000000,)",
            "(40, 40)",
            "(True,)",
            "('a',)",
            "(1e3,)",
            "40",
        )
    )
    order = chance.choice(("False", "True", "None", "__import__('os').abort()"))
    header = f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}"
    header = chance.choice((header, header, header, header[:-9], "(" * 3000, "{" + "1:" * 500, " " * 60000, "[]"))
    version = chance.choice((b"\x01\x00", b"\x01\x00", b"\x02\x00", b"\x03\x00", b"\x09\x00"))
    text = header.encode() + b"\n"
    size = len(text) if chance.random() < 0.9 else chance.choice((0, 1, 65535))
    length = struct.pack("<H" if version[0] == 1 else "<I", min(size, 65535))
    return b"\x93NUMPY" + version + length + text + bytes(chance.choice((0, 8, 320, 400)))
