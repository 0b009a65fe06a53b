"""A good file for every reader: what the hostile ones are made of."""

import gzip
import io
import json
from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from mjx_starleth.names import JOINT_NAMES


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


@cache
def good_robustness() -> bytes:
    from experiments.robustness.file import SCHEMA_VERSION

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


def shipped(package: str, name: str) -> Callable[[], bytes]:
    """A file that comes with a package."""
    return (resources.files(package) / name).read_bytes


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
