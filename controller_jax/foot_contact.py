"""The point of a spherical foot that is nearest to the ground: where it is and how it moves."""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.leg_kinematics import LegKinematics
from controller_jax.rotations import cross, mtv, mv
from controller_jax.types import Array, LegGeometry


class Soles(NamedTuple):
    """Lowest points of the feet seen from the torso, (4, 3) each, in B."""

    r_BS_B: Array  # m
    v_BS_B: Array  # m/s, of the foot's material at that point, the torso held still
    J_BS_B: Array  # (4, 3, 3) v_BS_B over the joints' rates, m/rad: the ground's force acts there (eq. 7)


def soles(geometry: LegGeometry, legs: LegKinematics, q: Array, qd: Array, R_WB: Array, normal_W: Array) -> Soles:
    """Soles on a ground with the given normal (3,); q, qd (12,). A foot that rolls without slipping has v = 0."""
    down_B = jnp.broadcast_to(-geometry.foot_radius * mtv(R_WB, normal_W), (4, 3))
    angle = q.reshape(4, 3)[:, 0]
    zero, c, s = jnp.zeros_like(angle), jnp.cos(angle), jnp.sin(angle)
    haa, pitch = jnp.stack([zero + 1.0, zero, zero], -1), jnp.stack([zero, c, s], -1)
    turned = jnp.stack([cross(haa, down_B), *[cross(pitch, down_B)] * 2], -1)  # by HAA, and by HFE as by KFE
    J_BS_B = legs.J_BF_B + turned
    return Soles(legs.r_BF_B + down_B, mv(J_BS_B, qd.reshape(4, 3)), J_BS_B)
