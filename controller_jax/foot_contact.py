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


def soles(geometry: LegGeometry, legs: LegKinematics, q: Array, qd: Array, R_WB: Array, normal_W: Array) -> Soles:
    """Soles on a ground with the given normal (3,); q, qd (12,). A foot that rolls without slipping has v = 0."""
    down_B = jnp.broadcast_to(-geometry.foot_radius * mtv(R_WB, normal_W), (4, 3))
    angle, rate = q.reshape(4, 3)[:, 0], qd.reshape(4, 3)
    pitch_rate = rate[:, 1] + rate[:, 2]
    shank_omega_B = jnp.stack([rate[:, 0], pitch_rate * jnp.cos(angle), pitch_rate * jnp.sin(angle)], -1)
    v_BS_B = mv(legs.J_BF_B, rate) + cross(shank_omega_B, down_B)
    return Soles(legs.r_BF_B + down_B, v_BS_B)
