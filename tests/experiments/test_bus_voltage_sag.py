"""The supply that sags: its voltage under motors of known power, against the roots of its own law."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.effects import LIBRARY
from sea_jax.hooks import no_signals

OPEN = 48.0  # V without a load
SAG = LIBRARY["bus_voltage_sag"].equations["supply_voltage"]


def bus(resistance: jax.Array | float, switching: float, current: np.ndarray, winding: np.ndarray) -> jax.Array:
    signals = no_signals(jnp.zeros(len(current)), 1e-4)
    signals = signals._replace(current=jnp.asarray(current), winding_voltage=jnp.asarray(winding))
    everywhere = jnp.ones(len(current))
    p = SimpleNamespace(resistance=resistance * everywhere, switching=switching * everywhere)
    return SAG(p, OPEN * everywhere, signals)


def voltage(resistance: float, switching: float, current: np.ndarray, winding: np.ndarray) -> np.ndarray:
    return np.asarray(bus(resistance, switching, current, winding))


def upper_root(resistance: float, switching: float, current: np.ndarray, power: float) -> float:
    """V = OPEN - R ((1 - s) sum|I| + s P / V), solved as a polynomial."""
    linear = OPEN - resistance * (1.0 - switching) * np.abs(current).sum()
    return np.roots([1.0, -linear, resistance * switching * power]).real.max()


@pytest.mark.parametrize("switching", [0.0, 0.4, 1.0])
def test_the_bus_meets_the_law_of_its_amplifiers(switching: float) -> None:
    rng = np.random.default_rng(0)
    for resistance in (0.05, 0.3, 0.8):
        current = rng.uniform(0.0, 2.0, 12).astype(np.float32)
        winding = rng.uniform(1.0, 12.0, 12).astype(np.float32)
        expected = upper_root(resistance, switching, current, float(winding @ current))
        assert OPEN / 2 < expected < OPEN
        assert np.allclose(voltage(resistance, switching, current, winding), expected, rtol=1e-5)


def test_braking_motors_feed_the_others_and_not_the_supply() -> None:
    current, winding = np.float32([4.0, 3.0]), np.float32([10.0, -12.0])
    shared = voltage(1.0, 1.0, current, winding)
    assert np.allclose(shared, upper_root(1.0, 1.0, current, 4.0), rtol=1e-5)
    assert (voltage(1.0, 1.0, current, np.float32([10.0, -20.0])) == OPEN).all()


def test_no_supply_gives_more_power_than_at_half_its_voltage() -> None:
    current, winding = np.full(12, 30.0, np.float32), np.full(12, 40.0, np.float32)
    for switching in (0.0, 0.5, 1.0):
        assert (voltage(5.0, switching, current, winding) == OPEN / 2).all()
    slope = jax.grad(lambda r: bus(r, 1.0, current, winding).sum())(5.0)
    assert np.isfinite(slope)


def test_a_supply_without_resistance_is_the_same_to_the_bit() -> None:
    current, winding = np.float32([3.0, -2.0]), np.float32([11.3, -7.7])
    for switching in (0.0, 1.0):
        assert (voltage(0.0, switching, current, winding) == np.float32(OPEN)).all()
