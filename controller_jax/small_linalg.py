"""Inverses of tiny matrices in closed form or unrolled: no LAPACK call inside a vmapped rollout."""

import jax.numpy as jnp

from controller_jax.rotations import cross
from controller_jax.types import Array


def inverse3(A: Array) -> Array:
    """Inverse of (..., 3, 3) by its cofactors; for well-conditioned matrices."""
    a, b, c = A[..., 0], A[..., 1], A[..., 2]
    cofactors = jnp.stack([cross(b, c), cross(c, a), cross(a, b)], -2)
    return cofactors / (a * cofactors[..., 0, :]).sum(-1)[..., None, None]


def solve_spd(A: Array, b: Array) -> Array:
    """A^-1 b for one symmetric positive definite (n, n) and b (n, m), by Gauss-Jordan elimination."""
    n = A.shape[0]
    augmented = jnp.concatenate([A, b], 1)
    unit = jnp.eye(n)
    for k in range(n):
        row = augmented[k] / augmented[k, k]
        column = augmented[:, k] - unit[k]
        augmented = augmented - column[:, None] * row[None, :]
    return augmented[:, n:]


def inverse_spd(A: Array) -> Array:
    """Inverse of one symmetric positive definite (n, n), by Gauss-Jordan elimination."""
    return solve_spd(A, jnp.eye(A.shape[0]))
