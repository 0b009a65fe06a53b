"""The direction of the arrows between the packages, and what an import may not do."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import controller_jax
import es
import experiments
import mjx_starleth
import sea_jax

PACKAGES = {p.__name__: Path(p.__file__).parent for p in (controller_jax, es, experiments, mjx_starleth, sea_jax)}
FORBIDDEN = {
    "sea_jax": {"mujoco", "mjx_starleth", "controller_jax", "es", "experiments"},
    "controller_jax": {"mujoco", "mjx_starleth", "sea_jax", "es", "experiments"},
    "es": {"mujoco", "mjx_starleth", "sea_jax", "controller_jax", "experiments"},
    "mjx_starleth": {"sea_jax", "controller_jax", "es", "experiments"},
}


def imported(path: Path) -> set[str]:
    """Top-level names that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.split(".")[0])
    return found


@pytest.mark.parametrize("package", FORBIDDEN)
def test_arrows_point_one_way(package: str) -> None:
    for path in PACKAGES[package].rglob("*.py"):
        wrong = imported(path) & FORBIDDEN[package]
        assert not wrong, f"{path} imports {wrong}"


def test_the_independent_plant_shares_nothing_with_the_model() -> None:
    shared = {"jax", "mjx_starleth", "sea_jax", "controller_jax", "es"}
    for path in (PACKAGES["experiments"] / "independent_plant").rglob("*.py"):
        assert not imported(path) & shared, path


LAYERS = ("logs", "checks", "evidence", "fits", "selection")  # of the measurement: each knows those before it


@pytest.mark.parametrize("layer", LAYERS)
def test_the_measurement_is_built_in_layers(layer: str) -> None:
    root = "experiments.measurement."
    known = {root + name for name in LAYERS[: LAYERS.index(layer) + 1]}
    for path in (PACKAGES["experiments"] / "measurement" / layer).rglob("*.py"):
        nodes = ast.walk(ast.parse(path.read_text()))
        modules = {n.module for n in nodes if isinstance(n, ast.ImportFrom) and n.module and n.module.startswith(root)}
        assert not {m for m in modules if ".".join(m.split(".")[:3]) not in known}, path


def test_imports_configure_nothing() -> None:
    script = (
        "import os, jax; before = dict(os.environ), jax.config.values.copy()\n"
        "import mjx_starleth.bodies, sea_jax, controller_jax.squat_jump, es, experiments.tune, experiments.cli.main\n"
        "from jax._src import xla_bridge\n"
        "assert dict(os.environ) == before[0], 'environment'\n"
        "assert jax.config.values == before[1], 'jax.config'\n"
        "assert not xla_bridge._backends, 'an import started a device'\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=120)
