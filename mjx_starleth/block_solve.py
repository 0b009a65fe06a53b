"""The robot's mass matrix solved by hand: four 3 x 3 legs eliminated, the 6 x 6 rest by Cholesky. No LAPACK.

    M = [ M_base  C^T ]     leg i: A_i = M_leg_i^-1,  K_i = A_i C_i
        [ C     M_leg ]     Schur complement S = M_base - sum_i C_i^T K_i = L L^T

With B_i = J_base_i - J_leg_i K_i (the foot's Jacobian after the elimination) and G_i = L^-1 B_i^T the operational
inverse inertia is  J_i M^-1 J_j^T = G_i^T G_j + delta_ij J_leg_i A_i J_leg_i^T, so no column of M^-1 J^T is needed.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

Array = jax.Array


def product(a: Array, b: Array) -> Array:
    """a (..., m, k) times b (..., k, n) for small k, written out: see `total`."""
    return sum(a[..., :, k, None] * b[..., None, k, :] for k in range(a.shape[-1]))


def apply(a: Array, x: Array) -> Array:
    """a (..., m, n) times x (..., n)."""
    return total(a * x[..., None, :])


def total(x: Array, axis: int = -1) -> Array:
    """Sum over a short axis, written out: XLA's CPU compiler hands `sum` to a library that is 20 times slower here."""
    return sum(jax.lax.index_in_dim(x, k, axis, keepdims=False) for k in range(x.shape[axis]))


def transpose(a: Array) -> Array:
    return jnp.swapaxes(a, -1, -2)


def inverse3(a: Array) -> Array:
    """Inverse of symmetric matrices (..., 3, 3), closed form."""
    a00, a01, a02 = a[..., 0, 0], a[..., 0, 1], a[..., 0, 2]
    a11, a12, a22 = a[..., 1, 1], a[..., 1, 2], a[..., 2, 2]
    b00, b01, b02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    b11, b12, b22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    scale = 1 / (a00 * b00 + a01 * b01 + a02 * b02)
    rows = jnp.stack([b00, b01, b02, b01, b11, b12, b02, b12, b22], -1) * scale[..., None]
    return rows.reshape(a.shape)


class Factor(NamedTuple):
    """The eliminated mass matrix."""

    leg_inverse: Array  # (4, 3, 3) A
    gain: Array  # (4, 3, 6) K
    lower: Array  # (6, 6) L with 1/L_ii on its diagonal


def factor(m_base: Array, cross: Array, m_leg: Array) -> Factor:
    """Factor of a mass matrix given by its blocks (6, 6), (4, 3, 6), (4, 3, 3)."""
    inverse = inverse3(m_leg)
    gain = product(inverse, cross)
    schur = m_base - total(product(transpose(cross), gain), 0)
    return Factor(inverse, gain, _cholesky6(schur))


def _cholesky6(a: Array) -> Array:
    rows = []
    for i in range(6):
        row = []
        for j in range(i):
            row.append((a[i, j] - sum(row[k] * rows[j][k] for k in range(j))) * rows[j][j])
        row.append(jax.lax.rsqrt(a[i, i] - sum(x * x for x in row)))
        rows.append(row)
    return jnp.stack([jnp.stack(row + [jnp.zeros((), a.dtype)] * (5 - i)) for i, row in enumerate(rows)])


def forward_substitute(lower: Array, b: Array) -> Array:
    """L^-1 b for b (6, ...)."""
    x = []
    for i in range(6):
        x.append((b[i] - sum(lower[i, k] * x[k] for k in range(i))) * lower[i, i])
    return jnp.stack(x)


def back_substitute(lower: Array, b: Array) -> Array:
    """L^-T b for b (6, ...)."""
    x = [None] * 6
    for i in reversed(range(6)):
        x[i] = (b[i] - sum(lower[k, i] * x[k] for k in range(i + 1, 6))) * lower[i, i]
    return jnp.stack(x)


def solve(f: Factor, base: Array, leg: Array) -> tuple[Array, Array]:
    """M^-1 of a generalised force (6,) and (4, 3)."""
    rest = base - total(apply(transpose(f.gain), leg), 0)
    x = back_substitute(f.lower, forward_substitute(f.lower, rest))
    return x, apply(f.leg_inverse, leg) - apply(f.gain, x[None])
