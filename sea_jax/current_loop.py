"""Current loop (paper IV.2): PI with a clamped integrator, from wanted current to voltage within the bus."""

import jax.numpy as jnp

from sea_jax.parameters import DriveParams
from sea_jax.types import Array


def current_loop(
    params: DriveParams, wanted: Array, current: Array, integral: Array, bus_voltage: Array, period: float
) -> tuple[Array, Array]:
    """One update. Returns the motor voltage and the integrator, V."""
    error = wanted - current
    limit = params.current_integral_limit
    integral = jnp.clip(integral + params.current_ki * period * error, -limit, limit)
    voltage = params.current_kp * error + integral
    return jnp.clip(voltage, -bus_voltage, bus_voltage), integral
