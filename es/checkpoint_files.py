"""One checkpoint on the disk: what is written into its folder, and how damage in it is found.

    state/          the arrays, written by orbax
    manifest.json   the search's fingerprint, size and SHA-256 of every file under state/, and its own SHA-256

The sums are looked at before orbax sees a byte. (Orbax commits by a rename, but it does not sync its metadata and
notices a flipped bit only by luck.) Nothing is pickled, and no path or size from a file is trusted.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
import orbax.checkpoint as ocp

SCHEMA = 1
MANIFEST, STATE = "manifest.json", "state"
# A hundred thousand generations of twenty parameters are 20 MB; a file that claims more than this is not ours.
LARGEST_STATE = 256 * 2**20
LARGEST_MANIFEST = 2**20
SMALL_FILES = 2**18  # bytes that a checkpoint takes beside its arrays, generously


class Damaged(Exception):
    """Why one checkpoint folder is not whole."""


def write_checkpoint(folder: Path, arrays: Mapping[str, np.ndarray], fingerprint: dict[str, Any]) -> None:
    """Fill an empty folder; all of it is on the disk on return. Raises OSError, ValueError, RuntimeError (orbax's)."""
    _probe(folder / "probe", 2 * sum(array.nbytes for array in arrays.values()) + SMALL_FILES)
    _orbax().save(folder / STATE, args=ocp.args.PyTreeSave(dict(arrays)))
    _write_manifest(folder, fingerprint)
    for path in [folder, *folder.rglob("*")]:
        sync(path)


def read_manifest(folder: Path) -> Any:
    """Fingerprint of a checkpoint after checking every file's size and sum; raises Damaged."""
    manifest = _parse_manifest(folder / MANIFEST)
    found = {}
    for path in sorted((folder / STATE).rglob("*")):
        if path.is_symlink() or not (path.is_dir() or path.is_file()):
            raise Damaged(f"{path.relative_to(folder)} is not a plain file")
        if path.is_file():
            found[path.relative_to(folder).as_posix()] = path
    listed = manifest["files"]
    for name in sorted(listed.keys() ^ found.keys()):
        raise Damaged(f"{name} is missing" if name in listed else f"{name} is not in its manifest")
    if sum(path.stat().st_size for path in found.values()) > LARGEST_STATE:
        raise Damaged(f"it is larger than {LARGEST_STATE} bytes")
    for name, path in found.items():
        if listed[name] != _signature(path):
            raise Damaged(f"{name} does not match its checksum")
    return manifest["fingerprint"]


def _parse_manifest(path: Path) -> dict[str, Any]:
    """The manifest, if its own sum is right; raises Damaged."""
    try:
        with path.open("rb") as file:
            text = file.read(LARGEST_MANIFEST + 1)
    except OSError as error:
        raise Damaged(f"{MANIFEST} cannot be read: {error.strerror}") from None
    try:
        manifest = json.loads(text)
        stated = manifest.pop("sha256")
        whole = len(text) <= LARGEST_MANIFEST and stated == _manifest_sum(manifest)
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
        whole = False
    if not whole:
        raise Damaged(f"{MANIFEST} does not match its checksum")
    if manifest.get("schema") != SCHEMA or not isinstance(manifest.get("files"), dict):
        raise Damaged(f"{MANIFEST} is not of schema {SCHEMA}")
    return manifest


def _write_manifest(folder: Path, fingerprint: dict[str, Any]) -> None:
    files = {
        path.relative_to(folder).as_posix(): _signature(path)
        for path in sorted((folder / STATE).rglob("*"))
        if path.is_file()
    }
    manifest = {"schema": SCHEMA, "fingerprint": fingerprint, "files": files}
    manifest["sha256"] = _manifest_sum(manifest)
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1), encoding="utf-8")


def _manifest_sum(manifest: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def _signature(path: Path) -> dict[str, Any]:
    return {"bytes": path.stat().st_size, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def read_arrays(folder: Path) -> dict[str, np.ndarray]:
    """Arrays of a checkpoint whose sums are right; their sizes are looked at before they are read. Raises Damaged."""
    state = folder / STATE
    try:
        metadata = _orbax().metadata(state).item_metadata.tree
        claimed = sum(int(np.prod(entry.shape)) * np.dtype(entry.dtype).itemsize for entry in metadata.values())
        if claimed > LARGEST_STATE:
            raise Damaged(f"its arrays claim {claimed} bytes")
        as_numpy = {name: ocp.RestoreArgs(restore_type=np.ndarray) for name in metadata}
        return _orbax().restore(state, args=ocp.args.PyTreeRestore(restore_args=as_numpy))
    except Damaged:
        raise
    except Exception as error:  # whatever orbax and tensorstore make of a file that was forged, sums and all
        raise Damaged(f"orbax cannot read it: {first_line(error)}") from None


def _orbax() -> ocp.Checkpointer:
    """Orbax's synchronous checkpointer, for this process alone: every process holds the whole state."""
    this = jax.process_index()
    alone = ocp.options.MultiprocessingOptions(
        primary_host=this, active_processes={this}, barrier_sync_key_prefix=f"process_{this}"
    )
    return ocp.Checkpointer(ocp.PyTreeCheckpointHandler(multiprocessing_options=alone), multiprocessing_options=alone)


def _probe(path: Path, size: int) -> None:
    """Write and delete a plain file: of a full disk it raises an OSError, where orbax's threads print tracebacks."""
    path.write_bytes(bytes(size))
    path.unlink()


def sync(path: Path) -> None:
    """A file's content, or a folder's list of names, down to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def first_line(error: BaseException) -> str:
    """What an error of a library says, short enough for a sentence."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
