"""Velocity loop (paper IV.1): PI with a clamped integrator, from wanted motor velocity to wanted current."""

import jax.numpy as jnp

from sea_jax.parameters import DriveParams
from sea_jax.types import Array


def velocity_loop(
    params: DriveParams, wanted: Array, velocity: Array, integral: Array, period: float
) -> tuple[Array, Array]:
    """One update; velocities at the gear output, rad/s. Returns the wanted current and the integrator, A."""
    error = params.gear_ratio * (wanted - velocity)
    limit = params.velocity_integral_limit
    integral = jnp.clip(integral + params.velocity_ki * period * error, -limit, limit)
    current = params.velocity_kp * error + integral
    return jnp.clip(current, -params.current_limit, params.current_limit), integral
