"""How a good file becomes a hostile one, for every kind of file."""

import hashlib
import io
import json
import random
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from experiments.fuzz import mutations as hostile
from experiments.fuzz.good_files import columns, good_csv, good_info, good_parameters


def one_file(name: str, good: Callable[[], bytes], mutate: hostile.Mutate) -> Callable[[Path, random.Random], None]:
    """A file of that name, hostile."""

    def prepare(folder: Path, chance: random.Random) -> None:
        (folder / name).write_bytes(mutate(good(), chance))

    return prepare


def signed_parameters(data: bytes, chance: random.Random) -> bytes:
    """Half of them with a checksum that is right, as somebody would write who means harm."""
    from experiments.parameter_file import checksum

    data = hostile.json_file(data, chance)
    if chance.random() < 0.5:
        return data
    try:
        content = json.loads(data)
        return json.dumps(content | {"checksum": checksum(content)}).encode()
    except Exception:  # not even JSON any more
        return data


def parquet_file(data: bytes, chance: random.Random) -> bytes:
    """Plain damage, or a whole file of other contents."""
    if chance.random() < 0.8:
        return hostile.damaged(data, chance)
    kinds = (
        pa.array(["x"] * 20),
        pa.array([[1.0]] * 20),
        pa.array([{"a": 1}] * 20),
        pa.array([None] * 20),
        pa.array([b"\xff"] * 20),
        pa.array([2**63] * 20, pa.uint64()),
        pa.array([0] * 20, pa.timestamp("ns")),
        pa.array(["a", "b"] * 10).dictionary_encode(),
        pa.array([True, None] * 10),
        pa.array([1.5, None] * 10, pa.float16()) if hasattr(pa, "float16") else pa.nulls(20),
    )
    table = dict(columns())
    table[chance.choice(list(table))] = chance.choice(kinds)
    if chance.random() < 0.3:
        table["\ud800x".encode("utf-8", "replace").decode()] = table["time"]
    buffer = io.BytesIO()
    packing = chance.choice(("snappy", "gzip", "zstd", "none"))
    pa.parquet.write_table(pa.table(table), buffer, compression=packing)
    return buffer.getvalue()


def prepare_sweep_folder(folder: Path, chance: random.Random) -> None:
    """One finished member that failed before; one of its files is hostile."""
    run = folder / "members" / "a.nominal.seed0"
    run.mkdir(parents=True)
    (folder / "outcomes").mkdir()
    outcome = {"name": "a.nominal.seed0", "exit_code": 1, "sentence": "x", "attempt": 1, "seconds": 2.0}
    record = {"schema_version": 1, "command": "tune", "settings": {}, "finished": True}
    files = {
        folder / "outcomes" / "a.nominal.seed0.json": json.dumps(outcome).encode(),
        run / "run.json": json.dumps(record).encode(),
        run / "parameters.json": good_parameters(),
    }
    victim = chance.choice(list(files))
    for path, content in files.items():
        path.write_bytes(hostile.json_file(content, chance) if path == victim else content)


def prepare_run_folder(folder: Path, chance: random.Random) -> None:
    """A run that was left, its record hostile."""
    (folder / "run").mkdir()
    record = {"schema_version": 1, "command": "tune", "settings": {"seed": 1}, "finished": False}
    (folder / "run" / "run.json").write_bytes(hostile.json_file(json.dumps(record).encode(), chance))


@cache
def _checkpoints() -> Path:
    """Two good checkpoints of a small search, made once in this process."""
    import tempfile

    import es

    folder = Path(tempfile.mkdtemp(prefix="starleth_fuzz_"))
    checkpointer = es.Checkpointer(folder, {"task": "x"}, seconds_between=0.0)
    checkpointer.open({"settings": 1})
    for generation in (1, 2):
        checkpointer.save(generation, {"position": np.array([0, generation]), "mean": np.zeros(5, np.float32)})
    return folder


def prepare_checkpoints(folder: Path, chance: random.Random) -> None:
    """Two checkpoints, the newest damaged in one file or two, and sometimes signed again."""
    shutil.copytree(_checkpoints(), folder / "checkpoints")
    newest = folder / "checkpoints" / "generation_00000002"
    files = sorted(path for path in newest.rglob("*") if path.is_file())
    for _ in range(chance.randint(1, 2)):
        victim = chance.choice(files)
        mutate = hostile.json_file if victim.name == "manifest.json" else hostile.damaged
        try:
            victim.write_bytes(mutate(victim.read_bytes(), chance))
        except ValueError:  # the second damage to JSON that is none any more
            victim.write_bytes(hostile.damaged(victim.read_bytes(), chance))
    if chance.random() < 0.3:
        _forge(newest, chance)


def _forge(checkpoint: Path, chance: random.Random) -> None:
    """Sums that are right for what lies there now, so that orbax gets to see it."""
    try:
        manifest = json.loads((checkpoint / "manifest.json").read_bytes())
        manifest.pop("sha256")
        for name in manifest["files"]:
            content = (checkpoint / name).read_bytes()
            manifest["files"][name] = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
        manifest["sha256"] = hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()
        (checkpoint / "manifest.json").write_text(json.dumps(manifest))
    except Exception:  # the manifest itself was the victim
        return


def torn(data: bytes, chance: random.Random) -> bytes:
    """Cut off anywhere, or a byte flipped: what a person's own file may be. It runs as code, so nothing worse."""
    at = chance.randrange(len(data))
    return (
        data[:at]
        if chance.random() < 0.7
        else data[:at] + bytes([data[at] ^ 1 << chance.randrange(5)]) + data[at + 1 :]
    )


def with_info(prepare: Callable[[Path, random.Random], None]) -> Callable[[Path, random.Random], None]:
    """A good JSON beside the log."""

    def both(folder: Path, chance: random.Random) -> None:
        (folder / "log.json").write_bytes(good_info())
        prepare(folder, chance)

    return both


def with_log(prepare: Callable[[Path, random.Random], None]) -> Callable[[Path, random.Random], None]:
    """A good log, and its JSON unless that is the hostile file."""

    def both(folder: Path, chance: random.Random) -> None:
        (folder / "log.csv").write_bytes(good_csv())
        (folder / "log.json").write_bytes(good_info())
        prepare(folder, chance)

    return both
