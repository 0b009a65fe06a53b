"""Closed-form kinematics of the four legs in the torso frame B.

A point of a leg lies a, b, c metres down the hip, thigh and shank (the links hang along -z at zero
angles). With s1, c1 of HFE, s12, c12 of HFE + KFE and s0, c0 of HAA,

    x = -(b s1 + c s12),    d = a + b c1 + c c12,    r_BP = r_BH + (x, s0 d, -c0 d),

which is linear in a, b, c. So the centre of mass of a whole leg is also such a point, and its Jacobian
gives the sum over the links in eqs. 5 and 7 at the price of one point.
"""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.rotations import TINY
from controller_jax.types import Array, LegGeometry

# The inverse kinematics keeps the foot this far below the HFE axis, m: higher up the leg's angles are
# ambiguous, and no motion goes there.
MIN_DROP = 0.05


class LegKinematics(NamedTuple):
    """Feet and legs' centres of mass seen from the torso origin, in B; m and m/rad."""

    r_BF_B: Array  # (4, 3) centres of the feet
    J_BF_B: Array  # (4, 3, 3) d r_BF_B / d (HAA, HFE, KFE)
    r_BG_B: Array  # (4, 3) centre of mass of each leg
    J_BG_B: Array  # (4, 3, 3)


def leg_kinematics(geometry: LegGeometry, q: Array) -> LegKinematics:
    """Positions and Jacobians of feet and leg centres of mass for joint positions q (12,), rad."""
    foot = jnp.stack([geometry.hip_length, geometry.thigh_length, geometry.shank_length])
    r, J = _leg_points(geometry, q, jnp.stack([foot, _centre_of_mass(geometry)]))
    return LegKinematics(r[0], J[0], r[1], J[1])


def leg_mass(geometry: LegGeometry) -> Array:
    """Mass of one leg, kg, ()."""
    return geometry.link_mass.sum()


def _centre_of_mass(geometry: LegGeometry) -> Array:
    """Lengths a, b, c (3,) of the leg's centre of mass: mass-weighted mean of those of its links."""
    hip, thigh, shank = geometry.link_mass
    com = geometry.link_com
    a = hip * com[0] + (thigh + shank) * geometry.hip_length
    b = thigh * com[1] + shank * geometry.thigh_length
    return jnp.stack([a, b, shank * com[2]]) / leg_mass(geometry)


def _leg_points(geometry: LegGeometry, q: Array, lengths: Array) -> tuple[Array, Array]:
    """Points with lengths a, b, c (p, 3) on all legs: positions (p, 4, 3), Jacobians (p, 4, 3, 3)."""
    angles = q.reshape(4, 3)
    pitch = jnp.stack([angles[:, 1], angles[:, 1] + angles[:, 2]])
    s0, c0, s, c = jnp.sin(angles[:, 0]), jnp.cos(angles[:, 0]), jnp.sin(pitch), jnp.cos(pitch)
    s0, c0 = s0[None], c0[None]
    thigh_x, thigh_d = lengths[:, 1:2] * s[:1], lengths[:, 1:2] * c[:1]  # (p, 4)
    shank_x, shank_d = lengths[:, 2:3] * s[1:], lengths[:, 2:3] * c[1:]
    x, drop = -(thigh_x + shank_x), thigh_d + shank_d
    d = lengths[:, :1] + drop
    zero = jnp.zeros_like(d)
    r = geometry.r_BH_B[None] + jnp.stack([x, s0 * d, -c0 * d], -1)
    J_HAA = jnp.stack([zero, c0 * d, s0 * d], -1)
    J_HFE = jnp.stack([-drop, s0 * x, -c0 * x], -1)
    J_KFE = jnp.stack([-shank_d, -s0 * shank_x, c0 * shank_x], -1)
    return r, jnp.stack([J_HAA, J_HFE, J_KFE], -1)


def abduction(geometry: LegGeometry, r_BF_B: Array) -> Array:
    """HAA (4,) of legs whose feet are at r_BF_B (4, 3), rad; beyond its stops, too."""
    r = r_BF_B - geometry.r_BH_B
    return jnp.arctan2(r[:, 1], jnp.maximum(-r[:, 2], geometry.hip_length + MIN_DROP))


def inverse_kinematics(geometry: LegGeometry, r_BF_B: Array) -> Array:
    """Joint positions q (12,) that bring the feet to r_BF_B (4, 3), clamped to the joint limits.

    A target out of reach is approached along the line from the HFE axis. Finite for every target.
    """
    x, y, z = jnp.moveaxis(r_BF_B - geometry.r_BH_B, -1, 0)
    HAA = abduction(geometry, r_BF_B)
    hip, thigh, shank = geometry.hip_length, geometry.thigh_length, geometry.shank_length
    height = jnp.maximum(-z, hip + MIN_DROP)
    drop = jnp.sqrt(y * y + height * height) - hip
    limits = geometry.position_limits.reshape(4, 3, 2)
    knee = jnp.abs(limits[:, 2])  # folded the most and the least, in either order
    cosine = (x * x + drop * drop - thigh * thigh - shank * shank) / (2.0 * thigh * shank)
    cosine = jnp.clip(cosine, jnp.cos(knee.max(1)), jnp.cos(knee.min(1)))
    sine = geometry.knee_sign * jnp.sqrt(1.0 - cosine * cosine + TINY)
    KFE = jnp.arctan2(sine, cosine)
    HFE = jnp.arctan2(-x, drop) - jnp.arctan2(shank * sine, thigh + shank * cosine)
    q = jnp.stack([HAA, HFE, KFE], -1)
    return jnp.clip(q, limits[:, :, 0], limits[:, :, 1]).reshape(12)
