"""Joint spring (paper IV.6): tau = c(delta) delta + d(delta) ddelta, delta = gear angle - joint angle.

Hips have one linear spring. The knee's spring carries torque of one sign only; on the other side it meets
its stop, which is stiffer and damped more.
"""

from collections.abc import Callable

import jax.numpy as jnp

from sea_jax.parameters import DriveParams
from sea_jax.types import Array


def spring_coefficients(params: DriveParams, deflection: Array) -> tuple[Array, Array]:
    """Stiffness, N m/rad, and damping, N m s/rad, that act at this deflection."""
    on_stop = params.spring_side * deflection < 0.0
    return (
        jnp.where(on_stop, params.stop_stiffness, params.spring_stiffness),
        jnp.where(on_stop, params.stop_damping, params.spring_damping),
    )


def spring_torque(
    params: DriveParams, deflection: Array, rate: Array, coefficients: Callable = spring_coefficients
) -> Array:
    """Torque of the spring on the link, (J,) N m."""
    stiffness, damping = coefficients(params, deflection)
    return stiffness * deflection + damping * rate


def deflection_at(params: DriveParams, torque: Array) -> Array:
    """Deflection at rest under a torque, rad: the inverse of the spring's law."""
    stiffness, _ = spring_coefficients(params, torque)
    return torque / stiffness
