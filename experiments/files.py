"""Files that are whole or not there: atomic writes, and bounded, strict reading of JSON from strangers.

A write goes to a temporary file in the same folder, is flushed to the disk, and takes the name in one step
(rename(2)); the folder is flushed too. Killed at any moment, a file holds the old contents or the new,
never a mix.
"""

import errno
import json
import math
import os
import re
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, ValidationError

from experiments.errors import UserError

MAX_DEPTH: Final = 32  # the deepest file of the project has 6 levels; deeper is an attack or a mistake
MAX_INTEGER_DIGITS: Final = 20  # holds every 64-bit integer; longer ones cost quadratic time to convert
TEMPORARY_NAME: Final = re.compile(r"^\..+\.[0-9a-f]{16}\.tmp$")
"""What `write_bytes` leaves behind when it is killed; safe to delete while nothing writes into the folder."""

_FULL_DISK: Final = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file would be larger than this system allows",
}


class Strict(BaseModel):
    """A record in a file from strangers: unknown keys are refused, nothing is changed afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def shown(path: Path | str) -> str:
    """A path or name as it may stand in a one-line message: no control characters, long ones shortened."""
    text = "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(path))
    return text if len(text) <= 200 else text[:90] + "…" + text[-90:]


def first_complaint(error: ValidationError) -> str:
    """The first of pydantic's complaints, with its place in the file, as the rest of a sentence."""
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    place = shown(".".join(str(part) for part in first["loc"]))
    objects = first["type"] in ("model_type", "dict_type", "model_attributes_type")
    message = "must be a JSON object" if objects else first["msg"].removeprefix("Value error, ")
    return shown(f"'{place}': {message[:1].lower()}{message[1:]}" if place else message)


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write a file atomically and durably. Raises UserError (full disk, no permission, no such folder)."""
    target = Path(path)
    with _sentence(f"cannot write {shown(target)}"):
        _refuse_special(target)
        temporary = target.with_name(f".{target.name}.{secrets.token_hex(8)}.tmp")
        try:
            # not tempfile: its mode 0600 would keep the results from everybody but their owner
            descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, target)
        except BaseException:  # Ctrl-C too
            with suppress(OSError):
                temporary.unlink()
            raise
        _sync_folder(target.parent)


def write_text(path: Path | str, text: str) -> None:
    """`write_bytes` of UTF-8 text."""
    write_bytes(path, text.encode())


def write_json(path: Path | str, value: Any) -> None:
    """`write_bytes` of indented JSON. Raises ValueError for NaN and infinity: they are not JSON."""
    write_text(path, json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def json_line(value: Any) -> str:
    """One line of JSON; null stands for numbers that are not finite."""
    return json.dumps(nan_as_null(value), ensure_ascii=False, allow_nan=False)


def nan_as_null(value: Any) -> Any:
    """Nested dictionaries and lists with None for the numbers that JSON does not know."""
    if isinstance(value, dict):
        return {key: nan_as_null(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [nan_as_null(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_bytes(path: Path | str, max_bytes: int) -> bytes:
    """The contents of a regular file of at most `max_bytes`. Raises UserError."""
    with _sentence(f"cannot read {shown(path)}"):
        # O_NONBLOCK: opening a named pipe must not hang
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise UserError(f"{shown(path)} is not a file; give the name of a file.")
            data = file.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise UserError(f"{shown(path)} is larger than {max_bytes} bytes, which no file of this kind is.")
    return data


def read_json(path: Path | str, max_bytes: int, max_depth: int = MAX_DEPTH) -> Any:
    """Parse a JSON file that may come from anybody.

    Refuses, with a UserError of one sentence: other files than regular ones, more than `max_bytes`, text
    that is not UTF-8, NaN and infinities (also as 1e999), integers of more than 20 digits, duplicate keys,
    lone surrogates, and nesting deeper than `max_depth`.
    """
    return parse_json(read_bytes(path, max_bytes), shown(path), max_depth)


def parse_json(data: bytes, name: str, max_depth: int = MAX_DEPTH) -> Any:
    """`read_json` of bytes already read; `name` is what the message calls them."""
    try:
        value = json.loads(
            data.decode(),
            parse_constant=_no_constant,
            parse_float=_finite,
            parse_int=_integer,
            object_pairs_hook=_unique,
        )
        _check_tree(value, max_depth)
    except UnicodeDecodeError as error:
        raise UserError(f"{name} is not UTF-8 text (byte {error.start}); it is damaged or of another kind.") from None
    except json.JSONDecodeError as error:
        raise UserError(
            f"{name} is not valid JSON (line {error.lineno}, column {error.colno}: {error.msg}); "
            "it is damaged or of another kind."
        ) from None
    except RecursionError:
        raise UserError(f"{name} is nested deeper than {max_depth} levels, which no file of this kind is.") from None
    except _RefusedError as error:
        raise UserError(f"{name} {error}; it is damaged or of another kind.") from None
    return value


class _RefusedError(ValueError):
    """Valid for the json module, but not for us; the message completes the sentence '<file> …'."""


def _no_constant(text: str) -> float:
    raise _RefusedError(f"holds {text}, which is not a JSON number")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise _RefusedError(f"holds the number {text[:40]}, which is too large")
    return value


def _integer(text: str) -> int:
    if len(text) > MAX_INTEGER_DIGITS:
        raise _RefusedError(f"holds an integer of {len(text)} digits")
    return int(text)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) != len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))
        raise _RefusedError(f"holds the key '{shown(twice)}' twice")
    return result


def _check_tree(value: Any, levels_left: int) -> None:
    if isinstance(value, str):
        if not value.isascii():
            try:
                value.encode()
            except UnicodeEncodeError:
                raise _RefusedError("holds half of a surrogate pair") from None
    elif isinstance(value, dict | list):
        if levels_left == 0:
            raise RecursionError
        children = value if isinstance(value, list) else [*value.keys(), *value.values()]
        for child in children:
            _check_tree(child, levels_left - 1)


@contextmanager
def _sentence(what: str) -> Iterator[None]:
    """Turn an operating system's error into one sentence."""
    try:
        yield
    except OSError as error:
        if error.errno in _FULL_DISK:
            reason = f"{_FULL_DISK[error.errno]}; make room and run again, what was there before is untouched"
        else:
            reason = (error.strerror or str(error)).lower()
        raise UserError(f"{what}: {reason}.") from None
    except ValueError as error:  # a NUL character in a path
        raise UserError(f"{what}: {error}.") from None


def refuse_unwritable(path: Path | str) -> None:
    """Say before the work, not after it, that its result could not be written. Raises UserError."""
    target = Path(path)
    with _sentence(f"cannot write {shown(target)}"):
        _refuse_special(target)
    if not target.parent.is_dir() or not os.access(target.parent, os.W_OK):
        raise UserError(f"cannot write {shown(target)}: {shown(target.parent)} is no folder that can be written into.")


def _refuse_special(target: Path) -> None:
    """Renaming onto /dev/null would replace the device; onto a folder it fails late."""
    try:
        mode = os.stat(target).st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a device or pipe"
        raise UserError(f"cannot write {shown(target)}: it is {kind}; give the name of a file.")


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems cannot flush a folder
            raise
    finally:
        os.close(descriptor)
