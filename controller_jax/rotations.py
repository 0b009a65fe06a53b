"""Rotations and small products.

The products are sums of slices: under vmap XLA's CPU code for a reduction over a handful of entries takes five to
twelve times as long.
"""

import jax.numpy as jnp

from controller_jax.types import Array

# Added to squares under a root: keeps the root differentiable at zero, far below any length that matters.
TINY = 1e-12


def mm(a: Array, b: Array) -> Array:
    """Matrix product (..., m, k) (..., k, n) -> (..., m, n)."""
    return sum(a[..., :, k, None] * b[..., None, k, :] for k in range(a.shape[-1]))


def mv(a: Array, v: Array) -> Array:
    """Matrix times vector, (..., m, k) (..., k) -> (..., m)."""
    return sum(a[..., :, k] * v[..., None, k] for k in range(a.shape[-1]))


def mtv(a: Array, v: Array) -> Array:
    """Transposed matrix times vector, (..., k, m) (..., k) -> (..., m)."""
    return sum(a[..., k, :] * v[..., k, None] for k in range(a.shape[-2]))


def dot(a: Array, b: Array) -> Array:
    """Inner product over the last axis, (..., k) (..., k) -> (...)."""
    return sum(a[..., k] * b[..., k] for k in range(a.shape[-1]))


def cross(a: Array, b: Array) -> Array:
    """Cross product of (..., 3) vectors."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return jnp.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], -1)


def skew(v: Array) -> Array:
    """(..., 3) -> (..., 3, 3) with skew(v) @ w = v x w."""
    zero = jnp.zeros_like(v[..., 0])
    rows = ((zero, -v[..., 2], v[..., 1]), (v[..., 2], zero, -v[..., 0]), (-v[..., 1], v[..., 0], zero))
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


def normalize(v: Array) -> Array:
    """Unit vector along (..., 3)."""
    return v / jnp.sqrt(dot(v, v) + TINY)[..., None]


def rotation_log(R: Array) -> Array:
    """Rotation vector of (..., 3, 3): angle times axis, rad. Good to 1e-3 rad short of half a turn."""
    RT = jnp.swapaxes(R, -1, -2)
    half = 0.5 * (R - RT)  # sin(angle) * skew(axis)
    s = jnp.stack([half[..., 2, 1], half[..., 0, 2], half[..., 1, 0]], -1)
    sine = jnp.sqrt(dot(s, s) + TINY)[..., None]
    cosine = 0.5 * (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1.0)[..., None]
    return s * (jnp.arctan2(sine, cosine) / sine)


def rotation_axis(angle: Array, axis: int) -> Array:
    """Turn by angle (...) about coordinate axis 0, 1 or 2: (..., 3, 3), frame turned to frame fixed."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    zero, one = jnp.zeros_like(c), jnp.ones_like(c)
    rows = {
        0: ((one, zero, zero), (zero, c, -s), (zero, s, c)),
        1: ((c, zero, s), (zero, one, zero), (-s, zero, c)),
        2: ((c, -s, zero), (s, c, zero), (zero, zero, one)),
    }[axis]
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


def control_frame(R_WB: Array, normal_W: Array) -> Array:
    """R_WC (3, 3) of the control frame: z the ground's normal, x the torso's x-axis laid on it (V.A.2)."""
    heading = R_WB[:, 0] - normal_W * dot(R_WB[:, 0], normal_W)
    x = normalize(heading)
    return jnp.stack([x, cross(normal_W, x), normal_W], -1)
