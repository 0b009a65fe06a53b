"""Tiny linear algebra without LAPACK: closed forms, or unrolled to scalars, which XLA fuses into one loop."""

import jax
import jax.numpy as jnp

from controller_jax.rotations import cross, dot
from controller_jax.types import Array


def inverse3(A: Array) -> Array:
    """Inverse of (..., 3, 3) by its cofactors; for well-conditioned matrices."""
    a, b, c = A[..., 0], A[..., 1], A[..., 2]
    cofactors = jnp.stack([cross(b, c), cross(c, a), cross(a, b)], -2)
    return cofactors / dot(a, cofactors[..., 0, :])[..., None, None]


def cholesky(A: Array) -> list[list[Array]]:
    """Rows of L with A = L L^T for a symmetric positive definite (n, n); the diagonal holds 1 / L_ii."""
    L: list[list[Array]] = []
    for i in range(A.shape[0]):
        row: list[Array] = []
        for j in range(i):
            row.append((A[i, j] - sum(row[k] * L[j][k] for k in range(j))) * L[j][j])
        row.append(jax.lax.rsqrt(A[i, i] - sum(x * x for x in row)))
        L.append(row)
    return L


def solve_cholesky(L: list[list[Array]], b: Array) -> Array:
    """A^-1 b (n, ...) from the factor of A."""
    n = len(L)
    y: list[Array] = []
    for i in range(n):
        y.append((b[i] - sum(L[i][k] * y[k] for k in range(i))) * L[i][i])
    x: list[Array] = [y[-1]] * n
    for i in reversed(range(n)):
        x[i] = (y[i] - sum(L[k][i] * x[k] for k in range(i + 1, n))) * L[i][i]
    return jnp.stack(x)
