"""Rotation of vectors and the exact motion of the generalised coordinates."""

import jax
import jax.numpy as jnp

from mjx_starleth.block_solve import total

Array = jax.Array

TINY = 1e-20  # rad^2: keeps the square root of no rotation differentiable


def cross(a: Array, b: Array) -> Array:
    """Cross product over the last axis, written out."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return jnp.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


def rotate(rotation: Array, v: Array) -> Array:
    """One rotation matrix (3, 3) times vectors (..., 3)."""
    columns = rotation.T.reshape(3, *(1,) * (v.ndim - 1), 3)
    return v[..., :1] * columns[0] + v[..., 1:2] * columns[1] + v[..., 2:] * columns[2]


def quaternion_product(p: Array, q: Array) -> Array:
    """Hamilton product of quaternions (..., 4), w x y z."""
    pw, px, py, pz = p[..., 0], p[..., 1], p[..., 2], p[..., 3]
    qw, qx, qy, qz = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    return jnp.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        -1,
    )


def rotation_quaternion(angle: Array) -> Array:
    """Quaternion (4,) of a rotation vector (3,), rad."""
    size = jnp.sqrt(total(angle * angle) + TINY)
    return jnp.concatenate([jnp.cos(size / 2)[None], angle * (jnp.sin(size / 2) / size)])


def integrate(q: Array, u: Array, period: float) -> Array:
    """q (19,) moved with constant u (18,) for a time: the torso turns about a fixed axis, exactly."""
    turned = quaternion_product(q[3:7], rotation_quaternion(period * u[3:6]))
    turned = turned * jax.lax.rsqrt(total(turned * turned))
    return jnp.concatenate([q[:3] + period * u[:3], turned, q[7:] + period * u[6:]])


def rotation_matrix(quaternion: Array) -> Array:
    """Torso to world (3, 3) of a unit quaternion (4,) w x y z."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])


def matrix_quaternion(R: Array) -> Array:
    """Unit quaternion (4,) w x y z of a rotation matrix (3, 3), by less than half a turn."""
    w = 0.5 * jnp.sqrt(jnp.maximum(1.0 + R[0, 0] + R[1, 1] + R[2, 2], 1e-12))
    axis = jnp.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return jnp.concatenate([w[None], axis / (4.0 * w)])
