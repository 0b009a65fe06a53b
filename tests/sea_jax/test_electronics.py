"""The winding between two updates of the current loop, against the integrated differential equation."""

import jax.numpy as jnp
import numpy as np
import pytest
from drive_scenarios import PARAMS
from scipy.integrate import solve_ivp

from sea_jax import DriveHooks, DriveState, JointCommand, JointMeasurement, JointMotion, LoopPeriods, select_joints
from sea_jax.control_period import signals_at
from sea_jax.electronics import electronics, winding
from sea_jax.full_drive import watched_drive

ONE = select_joints(PARAMS, [0])
N = {name: float(value[0]) for name, value in ONE._asdict().items()}


@pytest.mark.parametrize("period", [1e-5, 1e-4, 2e-3])
def test_one_step_is_exact_whatever_its_length(period):
    voltage, velocity, current = 20.0, 4.0, -3.0
    rotor = N["gear_ratio"] * velocity

    def rate(_, i):
        return (voltage - N["resistance"] * i - N["back_emf_constant"] * rotor) / N["inductance"]

    expected = solve_ivp(rate, (0.0, period), [current], rtol=1e-10, atol=1e-10).y[0, -1]
    values = (jnp.full(1, x, jnp.float32) for x in (voltage, velocity, current))
    found = electronics(winding(ONE, period), *values)
    np.testing.assert_allclose(found, [expected], rtol=1e-5)


def test_the_voltage_that_hooks_see_is_the_one_that_brought_the_current():
    """It is not what holds the current: a winding whose current rises gets more, and a supply has to give that."""
    zero, one, periods = jnp.zeros(1, jnp.float32), jnp.ones(1, jnp.float32), LoopPeriods()
    link = JointMotion(zero, zero, zero, zero)
    told = JointCommand(12.0 * one, zero, zero), JointMeasurement(zero, zero, zero, zero), link
    start = DriveState(zero, zero, zero, zero, zero, zero, {})

    def watch(seen, state, time):
        row = jnp.stack([state.current, state.motor_velocity, state.voltage], 1)
        return seen.at[jnp.round(time / periods.current).astype(int)].set(row[0])

    state, _, seen = watched_drive(ONE, start, told, DriveHooks(), periods, jnp.zeros((26, 3), jnp.float32), watch)
    current, velocity, voltage = np.asarray(seen, float).T
    left = np.exp(-N["resistance"] * periods.current / N["inductance"])
    settled = (current[1:] - left * current[:-1]) / (1.0 - left)
    expected = N["resistance"] * settled + N["back_emf_constant"] * N["gear_ratio"] * velocity[:-1]
    np.testing.assert_allclose(voltage[1:], expected, atol=2e-3)
    holding = N["resistance"] * current[1:] + N["back_emf_constant"] * N["gear_ratio"] * velocity[1:]
    assert np.abs(voltage[1:] - holding).max() > 1.0
    assert signals_at(ONE, state, link, 0.0, periods.current).winding_voltage == state.voltage
