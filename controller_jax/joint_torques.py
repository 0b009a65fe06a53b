"""Joint torques from contact forces (eq. 7): the Jacobian transposed, and the weight of the links."""

import jax.numpy as jnp

from controller_jax.leg_kinematics import LegKinematics, leg_mass
from controller_jax.rotations import mtv
from controller_jax.types import Array, LegGeometry


def weight_torque(geometry: LegGeometry, legs: LegKinematics, R_WB: Array) -> Array:
    """Joint torques (4, 3) that hold the weight of the links, -sum_k J_k^T f_g,k, N m."""
    up_B = geometry.gravity * R_WB[2]
    return leg_mass(geometry) * mtv(legs.J_BG_B, jnp.broadcast_to(up_B, (4, 3)))


def joint_torques(force: Array, J_BF: Array, weight: Array) -> Array:
    """Eq. 7: joint torques (12,) for ground forces on the feet (4, 3), Jacobians (4, 3, 3) in the same frame.

    weight (4, 3) comes from `weight_torque`.
    """
    return (weight - mtv(J_BF, force)).reshape(12)
