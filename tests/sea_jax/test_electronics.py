"""The winding between two updates of the current loop, against the integrated differential equation."""

import jax.numpy as jnp
import numpy as np
import pytest
from drive_scenarios import PARAMS
from scipy.integrate import solve_ivp

from sea_jax import select_joints
from sea_jax.electronics import electronics, winding

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
