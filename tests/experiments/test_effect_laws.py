"""The library's laws against closed forms, equation by equation; where they act is tested in test_effects.py."""

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.model import nominal_model
from experiments.plant import make_plant
from sea_jax.friction import Friction
from sea_jax.hooks import no_signals

STEP = 1e-4  # s


def law(name: str, hook: str, value: Any, parameters: dict[str, float], *memory: Any, **signals: float) -> Any:
    """What the equation of an effect makes of a value where it acts."""
    seen = no_signals(jnp.zeros(()), STEP)._replace(**{key: jnp.float32(x) for key, x in signals.items()})
    return LIBRARY[name].equations[hook](SimpleNamespace(**parameters), value, seen, *memory)


@pytest.mark.parametrize(
    ("name", "parameters", "signals", "coulomb", "smooth"),
    [
        ("stribeck_friction", {"torque": 0.02, "velocity": 0.5}, {"motor_velocity": -0.5}, 0.02 * np.exp(-1.0), 0.0),
        ("stribeck_friction", {"torque": 0.02, "velocity": 0.5}, {"motor_velocity": 5.0}, 0.0, 0.0),
        ("load_friction", {"coefficient": 1e-3}, {"spring_torque": -8.0}, 8e-3, 0.0),
        ("direction_dependent_friction", {"torque": 3e-3}, {"motor_velocity": -2.0}, 0.0, 3e-3),
        ("direction_dependent_viscous_friction", {"coefficient": 2e-3}, {"motor_velocity": -2.0}, 0.0, 4e-3),
    ],
)
def test_friction_has_more_of_its_own_part(name, parameters, signals, coulomb, smooth) -> None:
    found = law(name, "friction", Friction(jnp.float32(0.01), jnp.float32(-0.005)), parameters, **signals)
    np.testing.assert_allclose(found, (0.01 + coulomb, -0.005 + smooth), atol=1e-8)


RIPPLE = {"sine": 0.1, "cosine": 0.2, "constant_sine": 0.01, "constant_cosine": 0.03, "harmonic": 100.0}
QUARTER = np.pi / 200.0  # rad of the gear output, a quarter of a period of RIPPLE


@pytest.mark.parametrize(
    ("name", "hook", "value", "parameters", "signals", "expected"),
    [
        ("torque_constant", "motor_torque", 2.0, {"relative": -0.1}, {"current": 9.0}, 1.8),
        ("torque_constant_saturation", "motor_torque", 2.0, {"per_square_current": 0.01}, {"current": -10.0}, 1.0),
        ("torque_ripple", "motor_torque", 2.0, RIPPLE, {}, 2.0 + 0.4 + 0.03),
        ("torque_ripple", "motor_torque", 2.0, RIPPLE, {"motor_position": QUARTER}, 2.0 + 0.2 + 0.01),
        ("backlash", "deflection", 0.005, {"half_width": 0.01}, {}, 0.0),
        ("backlash", "deflection", -0.05, {"half_width": 0.01}, {}, -0.04),
        ("spring_stiffening", "spring", 3.0, {"cubic": 100.0}, {"deflection": -0.2}, 2.2),
        ("joint_coulomb_drag", "joint_drag", 0.5, {"torque": 2.0}, {"joint_velocity": -1.0}, -1.5),
        ("joint_viscous_drag", "joint_drag", 0.5, {"coefficient": 0.2}, {"joint_velocity": -1.0}, 0.3),
        (
            "bearing_friction",
            "joint_drag",
            0.5,
            {"coefficient": 1e-3},
            {"joint_velocity": 1.0, "radial_load": 3e2},
            0.8,
        ),
    ],
)
def test_a_value_becomes_what_the_law_says(name, hook, value, parameters, signals, expected) -> None:
    assert law(name, hook, jnp.float32(value), parameters, **signals) == pytest.approx(expected, abs=1e-6)


def test_hysteresis_follows_the_way_and_not_the_time() -> None:
    """Dahl's bristle from rest, and turned round: exponentials of the way over the width, at any speed."""
    parameters = {"torque": 2.0, "width": 0.02}

    def after(memory, way: float, steps: int):
        for _ in range(steps):
            torque, memory = law(
                "spring_hysteresis", "spring", 5.0, parameters, memory, deflection_rate=way / (steps * STEP)
            )
        return float(torque), memory

    for steps in (10, 200):
        torque, memory = after(jnp.zeros(1), 0.03, steps)
        there = 1.0 - np.exp(-1.5)
        assert torque == pytest.approx(5.0 + 2.0 * there, rel=1e-5)
        torque, _ = after(memory, -0.01, steps)
        assert torque == pytest.approx(5.0 + 2.0 * (-1.0 + (1.0 + there) * np.exp(-0.5)), rel=1e-5)


def drive_after(name: str, **parameters: float) -> Any:
    """The nominal drives' numbers with an effect on all joints."""
    return law(name, "drive_parameters", make_plant(nominal_model()).params.drive, parameters)


@pytest.mark.parametrize(
    ("name", "parameter", "field", "factor", "more"),
    [
        ("coulomb_friction", {"torque": 0.004}, "friction_coulomb", 1.0, 0.004),
        ("viscous_friction", {"coefficient": 2e-5}, "friction_viscous", 1.0, 2e-5),
        ("cubic_friction", {"coefficient": 1e-10}, "friction_cubic", 1.0, 1e-10),
        ("motor_inertia", {"relative": 0.2}, "motor_inertia", 1.2, 0.0),
        ("spring_stiffness", {"relative": -0.3}, "spring_stiffness", 0.7, 0.0),
        ("spring_damping", {"coefficient": 0.1}, "spring_damping", 1.0, 0.1),
    ],
)
def test_an_effect_on_the_drives_numbers_changes_its_own_alone(name, parameter, field, factor, more) -> None:
    before, after = make_plant(nominal_model()).params.drive, drive_after(name, **parameter)
    for other, value in before._asdict().items():
        expected = factor * value + more if other == field else value
        np.testing.assert_allclose(getattr(after, other), expected, rtol=1e-6, err_msg=other)


def test_an_effect_on_the_bodies_numbers_changes_its_own_alone() -> None:
    before = make_plant(nominal_model()).params.bodies
    links = np.r_[1.0, np.full(12, 1.3)]
    relative = {"relative": jnp.full(12, 0.3)}
    uphill = np.array([-0.1, -0.2, 1.0]) / np.linalg.norm([0.1, 0.2, 1.0])
    for name, parameters, expected in (
        ("link_mass", relative, {"mass": before.mass * links, "inertia": before.inertia * links[:, None]}),
        ("link_com", relative, {"com": before.com * links[:, None]}),
        ("ground_friction", {"relative": -0.3}, {"friction": before.friction * 0.7}),
        ("ground_compliance", {"compliance": 2e-5, "damping": 90.0}, {"compliance": 2e-5, "ground_damping": 90.0}),
        ("ground_compliance", {"compliance": 0.0, "damping": 90.0}, {}),
        ("ground_slope", {"x": 0.1, "y": 0.2}, {"terrain": before.terrain._replace(normal=uphill)}),
    ):
        parameters = {key: jnp.asarray(value, jnp.float32) for key, value in parameters.items()}
        after = law(name, "body_parameters", before, parameters)
        for field, value in (before._asdict() | expected).items():
            for found, wanted in zip(*map(leaves, (getattr(after, field), value)), strict=True):
                np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-9, err_msg=f"{name}: {field}")
    force = law("constant_force", "torso_force", jnp.ones(3), {"x": 1.0, "y": -2.0, "z": 3.0})
    np.testing.assert_array_equal(force, [2.0, -1.0, 4.0])


def leaves(value: Any) -> list[np.ndarray]:
    """Arrays of a number of the bodies, or of the terrain among them."""
    return [np.asarray(x) for x in (value if isinstance(value, tuple) else (value,))]
