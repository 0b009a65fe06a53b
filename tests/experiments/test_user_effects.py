"""A user's effect file: what it gets wrong is said in one sentence, before anything runs on it."""

from pathlib import Path

import numpy as np
import pytest

from experiments.effects import LIBRARY, load_effects
from experiments.effects.compose import activate
from experiments.effects.rehearsal import refuse_faulty
from experiments.errors import UserError
from experiments.measurement.fits.fit_types import Placed
from experiments.model import nominal_model
from mjx_starleth.body_types import nominal_params

FILE = """
import jax.numpy as jnp
from experiments.effects import Effect, Parameter

def equation({arguments}):
    return {result}

EFFECT = Effect("{name}", "about", "{part}", "{axis}", ({parameters}), {{"{hook}": equation}}, memory={memory})
"""
USUAL = {
    "arguments": "p, value, signals",
    "name": "mine",
    "part": "drive",
    "axis": "joint",
    "parameters": 'Parameter("a", "1", -1.0, 1.0, 0.1),',
    "hook": "motor_torque",
    "memory": 0,
}
BODIES = {"hook": "body_parameters", "axis": "torso", "part": "bodies"}
REMEMBERS = {"arguments": "p, value, signals, memory", "memory": 1}


def load(folder: Path, result: str, **changes) -> dict:
    path = folder / "mine.py"
    path.write_text(FILE.format(**USUAL | {"result": result} | changes))
    return load_effects([path])


@pytest.mark.parametrize(
    "result, changes",
    [
        ("value + p.a * jnp.tanh(signals.motor_velocity)", {}),
        ("value._replace(mass=value.mass.at[0].add(p.a))", {"hook": "body_parameters", "axis": "torso"}),
        ("value._replace(friction=value.friction * (1.0 - p.a))", {"hook": "body_parameters", "axis": "foot"}),
        ("value._replace(torque=value.torque + p.a * signals.joint_position)", {"hook": "measurement"}),
        ("value + p.a", {"hook": "torso_force", "axis": "torso", "part": "bodies"}),
        ("(value + p.a * memory[:, 0], memory.at[:, 0].set(value))", REMEMBERS),
        ("(value._replace(torque=value.torque + p.a * value.torque**2), memory)", REMEMBERS | {"hook": "measurement"}),
    ],
)
def test_what_readers_of_the_readme_write_is_taken(tmp_path: Path, result: str, changes: dict) -> None:
    assert "mine" in load(tmp_path, result, **changes)


@pytest.mark.parametrize(
    "result, changes, words",
    [
        ("value[:3] + p.a[:3]", {}, r"must return what it got, a \(12,\), not \(3,\)"),
        ("(value * p.a).sum()", {}, "must return what it got"),
        ("None", {}, "not NoneType"),
        ("value + p.a + 1e-6", {}, "strengths at zero it must return what it got"),
        ("value + p.b", {}, "fails with AttributeError.*no attribute 'b'"),
        ("value + p.a * signals.motor_pos", {}, "fails with AttributeError"),
        ("value + 0.0 * jnp.sqrt(p.a - 0.5)", {}, "returns NaN"),
        ("value + 0.0 * jnp.sqrt(0.05 - p.a)", {}, "returns NaN"),
        ("value + p.a / (jnp.float32(0.1) - p.a)", {}, "returns NaN or infinity"),
        ("value[:4] + p.a[:4]", {}, r"must return what it got, a \(12,\), not \(4,\)"),
        (
            "value._replace(position=value.position + p.a + 1e-3)",
            {"hook": "measurement"},
            "must return what it got, to",
        ),
        ("value._replace(mass=value.mass + p.a * signals.joint_position[0])", BODIES, "fails with AttributeError"),
        ("value", {"memory": 2}, "fails with TypeError"),
        ("value", REMEMBERS, "must return .value, memory"),
        ("(value, memory, p.a)", REMEMBERS, "must return .value, memory"),
        ("(value, memory[0])", REMEMBERS, r"must return .value, memory \(12, 1\)"),
        ("value._replace(torque=value.torque * (1 + p.a * value.torque))", {"hook": "measurement"}, "straight line"),
        ("value + p.a", {"hook": "nowhere"}, "no hook"),
        ("value + p.a", {"hook": "joint_drag", "memory": 1}, "none of its hooks keeps a memory; leave memory away"),
        ("value + p.a", {"axis": "joints"}, "no axis 'joints'"),
        ("value + p.a", {"part": "motor"}, "no part 'motor'"),
        ("value + p.a", {"name": "a@b"}, "a name has"),
        ("value + p.a", {"name": "backlash"}, "exists already"),
        ("value + p.a", {"parameters": ""}, "needs a parameter"),
        ("value + p.a", {"parameters": '("a", 1.0),'}, "a tuple of Parameter"),
        ("value + p.a", {"parameters": 2 * USUAL["parameters"]}, "same name"),
        ("value + p.a", {"parameters": 'Parameter("a b", "1", -1.0, 1.0, 0.1),'}, "must be a Python name"),
        ("value + p.a", {"parameters": 'Parameter("a", "1", -1.0, 1.0, 0.0),'}, "starts at 0"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path: Path, result: str, changes: dict, words: str) -> None:
    with pytest.raises(UserError, match=words):
        load(tmp_path, result, **changes)


@pytest.mark.parametrize("bound", ["EFFECTS = 5", "EFFECTS = EFFECT", "EFFECTS = (EFFECT, 3)", "EFFECT = None"])
def test_a_file_that_binds_no_effects_is_refused(tmp_path: Path, bound: str) -> None:
    path = tmp_path / "mine.py"
    path.write_text(FILE.format(**USUAL, result="value") + bound)
    with pytest.raises(UserError, match="must bind EFFECT"):
        load_effects([path])


def test_every_effect_of_the_library_keeps_what_is_asked_of_a_users() -> None:
    for effect in LIBRARY.values():
        refuse_faulty(effect)


def test_an_equation_may_write_at_a_place_of_the_nominal_numbers(tmp_path: Path) -> None:
    library = load(
        tmp_path, "value._replace(mass=value.mass.at[0].add(p.a))", hook="body_parameters", axis="torso", part="bodies"
    )
    active, numbers, _ = activate([Placed("mine", "torso", {"a": 0.5})], library)
    nominal = nominal_params(nominal_model().numbers)
    heavier = active.apply("body_parameters", numbers, nominal)
    np.testing.assert_allclose(heavier.mass - nominal.mass, np.eye(13)[0] * 0.5, atol=1e-6)
