"""Every reader of a file from outside, a good file for each, and how to make it hostile."""

import gzip
import hashlib
import io
import json
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from experiments import fuzz_mutations as hostile
from experiments.errors import UserError
from mjx_starleth.names import JOINT_NAMES


@dataclass(frozen=True)
class Reader:
    """`prepare(folder, chance)` leaves a hostile input; `read(folder)` reads it, and uses what it read a little.

    `read` must return or raise UserError with one sentence. `heavy`: an input costs so much more than others that
    only every heavy-th is taken.
    """

    name: str
    prepare: Callable[[Path, random.Random], None]
    read: Callable[[Path], Any]
    heavy: int = 1


def one_file(name: str, good: Callable[[], bytes], mutate: hostile.Mutate) -> Callable[[Path, random.Random], None]:
    """A file of that name, hostile."""

    def prepare(folder: Path, chance: random.Random) -> None:
        (folder / name).write_bytes(mutate(good(), chance))

    return prepare


# --- good files


@cache
def good_parameters() -> bytes:
    from experiments import parameter_file as p

    content = {
        "schema_version": p.SCHEMA_VERSION,
        "task": "squat_jump",
        "robot": "starleth",
        "model_hash": "0123456789abcdef",
        "parameters": [{"name": f"p{i}", "value": 0.5, "unit": "m", "low": 0.0, "high": 1.0} for i in range(4)],
        "metrics": {"cost": {"value": 1.5, "unit": "-", "spread": {"mean": 1.0, "std": 0.1, "low": 0.5, "high": 2.0}}},
        "cost_terms": {"apex": -1.0},
        "perturbed": {"trials": 32, "seed": 0, "perturbations": {"torso_mass": "normal"}},
        "robustness_gate": None,
        "drive": "full",
        "seed": 0,
        "search": {"generations": 10, "population": 15},
        "versions": {"jax": "0.10"},
        "created": "2026-01-01T00:00:00Z",
        "command": "starleth replay runs/x",
    }
    return json.dumps(content | {"checksum": p.checksum(content)}).encode()


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


@cache
def good_robustness() -> bytes:
    from experiments.robustness_file import SCHEMA_VERSION

    spread = {"unit": "-", "mean": 1.0, "std": 0.1, "low": 0.5, "p05": 0.6, "p50": 1.0, "p95": 1.8, "high": 2.0}
    content = {
        **{"schema_version": SCHEMA_VERSION, "task": "squat_jump", "robot": "starleth", "drive": "full", "seed": 0},
        **{"model_hash": "0" * 16, "tuned_on": "0" * 16, "parameters": "0" * 64, "trials": 64, "successes": 60},
        **{"success_rate": 0.9375, "ci95": [0.85, 0.98], "gate": None, "worst": [], "sensitivity": [], "survival": []},
        **{"margins": {"torque": spread}, "metrics": {"cost": spread}, "sampled": 64, "perturbations": {"x": "y"}},
        **{"versions": {"jax": "0.10"}, "created": "2026-01-01T00:00:00Z", "command": "starleth robustness x"},
    }
    return json.dumps(content).encode()


@cache
def good_model() -> bytes:
    from experiments.model import PlacedEffect, nominal_model

    placed = PlacedEffect.model_validate(
        {"effect": "coulomb_friction", "where": "all", "parameters": _effect_values("coulomb_friction")}
    )
    return json.dumps(nominal_model().with_effect(placed).model_dump(mode="json", exclude_none=True)).encode()


def _effect_values(name: str) -> dict[str, Any]:
    from experiments.effects.library import LIBRARY

    return {p.name: {"value": (p.low + p.high) / 2, "unit": p.unit} for p in LIBRARY[name].parameters}


@cache
def resource_text(folder: str, name: str) -> bytes:
    from importlib import resources

    return (resources.files(folder) / name).read_bytes()


def good_sweep() -> bytes:
    return json.dumps(
        {"tasks": ["squat_jump", "t.json"], "models": ["nominal", "m.json"], "seeds": "0-3,7", "generations": 10}
    ).encode()


def good_info() -> bytes:
    info = {
        "robot": "starleth",
        "experiment": "fixed_base",
        "sample_period": 0.0025,
        "noise_std": {"joint_torque": 0.1},
    }
    return json.dumps(info | {"units": {"joint_position": "deg"}, "source": "x"}).encode()


def good_map() -> bytes:
    columns = {"time": {"from": "time", "unit": "ms"}, "joint_position/*": {"from": "joint_position/*", "scale": -1}}
    return json.dumps({"delimiter": ",", "columns": columns, "names": {"LF_HAA": "LF_HAA"}}).encode()


GOOD_TOML: Final = b"""delimiter = ","
[columns]
time = { from = "time", unit = "ms" }
"joint_torque/LF_KFE" = { from = "joint_torque/LF_KFE", unit = "N mm", scale = -1, offset = 0.2 }
[names]
LF_HAA = "LF_HAA"
"""


@cache
def columns() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    signals = ("command_torque", "joint_position", "joint_torque")
    found = {f"{signal}/{joint}": rng.standard_normal(20).round(4) for signal in signals for joint in JOINT_NAMES[:3]}
    return {"time": np.arange(20) * 0.0025} | found


@cache
def good_csv() -> bytes:
    table = columns()
    rows = [",".join(table)] + [",".join(f"{x:.6g}" for x in row) for row in zip(*table.values(), strict=True)]
    return "\n".join(rows).encode()


@cache
def good_gzip() -> bytes:
    return gzip.compress(good_csv())


@cache
def good_npz() -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **columns())
    return buffer.getvalue()


@cache
def good_parquet() -> bytes:
    buffer = io.BytesIO()
    pa.parquet.write_table(pa.table(dict(columns())), buffer)
    return buffer.getvalue()


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


# --- reading


def read_parameters(folder: Path) -> None:
    from experiments import parameter_file

    parameter_file.read_parameters(folder / "parameters.json", robot="starleth", allow_ungated=True).values()


def read_robustness(folder: Path) -> None:
    from experiments import robustness_file

    robustness_file.read_robustness(folder / "robustness.json")


def read_model(folder: Path) -> None:
    from experiments.model import load_model

    model = load_model(folder / "model.json")
    model.hash()


def read_task(folder: Path) -> None:
    from experiments.model import nominal_model
    from experiments.tasks.definition import load_task
    from experiments.tasks.registry import make_task

    definition = load_task(str(folder / "task.json"))
    definition.with_generations(500_000)
    make_task(definition, _nominal(nominal_model))


def read_perturbations(folder: Path) -> None:
    from experiments.model import nominal_model
    from experiments.perturbations import load_perturbations

    found = load_perturbations(folder / "perturbations.json", _nominal(nominal_model))
    draws = np.linspace(0, 1, 3)
    for law in found.draw.values():
        law.draw(draws).astype(np.float32)


@cache
def _nominal(make: Callable[[], Any]) -> Any:
    return make()


def read_sweep(folder: Path) -> None:
    from experiments.sweep import load_sweep

    sweep = load_sweep(folder / "sweep.json")
    for member in sweep.members():
        if "/" in member.name or member.name.startswith(".") or len(member.name) > 200:
            raise AssertionError(f"the name {member.name!r} leaves the sweep's folder")
        if any(word.startswith("--effects") for word in sweep.tune_arguments(member)):
            raise AssertionError("a data file brought code")


def read_log(folder: Path) -> None:
    from experiments.measurement.log_reader import read_log

    log = next(path for path in folder.iterdir() if path.name.startswith("log") and path.suffix != ".json")
    maps = [path for path in folder.iterdir() if path.name.startswith("map")]
    found = read_log(log, column_map=maps[0] if maps else None)
    found.joints("joint_torque")


def read_sweep_folder(folder: Path) -> None:
    """run.json, outcome and results of a member as `collect` reads them."""
    from experiments.collect import collect, summary
    from experiments.sweep import Sweep

    summary(collect(folder, Sweep(tasks=("a",))))


def prepare_sweep_folder(folder: Path, chance: random.Random) -> None:
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


def read_run_folder(folder: Path) -> None:
    from experiments.run_folder import open_run

    with open_run(folder / "run", "tune", {"seed": 1}):
        pass


def prepare_run_folder(folder: Path, chance: random.Random) -> None:
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


def read_checkpoints(folder: Path) -> None:
    import es

    checkpointer = es.Checkpointer(folder / "checkpoints", {"task": "x"}, notify=lambda sentence: None)
    checkpointer.open({"settings": 1})
    try:
        arrays = checkpointer.load()
    except es.CheckpointError as error:
        raise UserError(f"{error}.") from None
    if arrays is None or not all(isinstance(value, np.ndarray) for value in arrays.values()):
        raise AssertionError("the older, whole checkpoint was not found")


def read_effect(folder: Path) -> None:
    from experiments.effects.library import load_effects

    load_effects([folder / "effect.py"])


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


READERS: Final[tuple[Reader, ...]] = (
    Reader("parameters", one_file("parameters.json", good_parameters, signed_parameters), read_parameters),
    Reader("robustness", one_file("robustness.json", good_robustness, hostile.json_file), read_robustness),
    Reader("model", one_file("model.json", good_model, hostile.json_file), read_model),
    Reader(
        "numbers",
        one_file("model.json", lambda: resource_text("mjx_starleth", "starleth.json"), hostile.json_file),
        read_model,
    ),
    Reader(
        "task",
        one_file("task.json", lambda: resource_text("experiments.tasks", "squat_jump.json"), hostile.json_file),
        read_task,
    ),
    Reader(
        "gait task",
        one_file("task.json", lambda: resource_text("experiments.tasks", "running_trot.json"), hostile.json_file),
        read_task,
    ),
    Reader(
        "perturbations",
        one_file("perturbations.json", lambda: resource_text("experiments", "perturbations.json"), hostile.json_file),
        read_perturbations,
    ),
    Reader("sweep", one_file("sweep.json", good_sweep, hostile.json_file), read_sweep),
    Reader("sweep folder", prepare_sweep_folder, read_sweep_folder),
    Reader("run folder", prepare_run_folder, read_run_folder, heavy=4),
    Reader("log csv", with_info(one_file("log.csv", good_csv, hostile.csv_file)), read_log),
    Reader("log csv.gz", with_info(one_file("log.csv.gz", good_gzip, hostile.gzip_file)), read_log, heavy=4),
    Reader("log parquet", with_info(one_file("log.parquet", good_parquet, parquet_file)), read_log),
    Reader("log npz", with_info(one_file("log.npz", good_npz, hostile.npz_file)), read_log),
    Reader("log json", with_log(one_file("log.json", good_info, hostile.json_file)), read_log),
    Reader("column map json", with_log(one_file("map.json", good_map, hostile.json_file)), read_log),
    Reader("column map toml", with_log(one_file("map.toml", lambda: GOOD_TOML, hostile.damaged)), read_log),
    Reader("checkpoints", prepare_checkpoints, read_checkpoints, heavy=10),
    Reader(
        "effect", one_file("effect.py", lambda: resource_text("experiments.examples", "cogging.py"), torn), read_effect
    ),
)
