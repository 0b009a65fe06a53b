"""The faces of each leg's force polyhedron on which rows are active, and the best force on them.

With the active rows of each leg orthonormalised (u_k), c the point on its faces nearest the origin and
P = I - sum u u^T, the best force on the faces is (Woodbury, in the six numbers of the wrench)

    force = c + load P A^T nu,    (W I + sum A load P A^T) nu = b - A c.
"""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.force_problem import ForceProblem, weighted_wrench
from controller_jax.rotations import TINY, dot, mm, mtv, mv
from controller_jax.small_linalg import cholesky, solve_cholesky
from controller_jax.types import Array

INDEPENDENT = 1e-3  # least part of a unit row off the others for it to count as a new direction
# Floor of the diagonal that is factored, in place of W: W is 1e-5 of S, too little for float32. Only wrenches that
# the faces cannot give are affected, and those only in nu, not in the force.
FLOOR = 2e-4


class Faces(NamedTuple):
    """Up to three active rows per leg, in slots; an empty slot is zero throughout."""

    row: Array  # (4, 3, 8) which row, one-hot
    side: Array  # (4, 3) +1 at the upper bound, -1 at the lower
    normal: Array  # (4, 3, 3) the row itself
    bound: Array  # (4, 3) N


class Basis(NamedTuple):
    """The active rows orthonormalised: normal_k = sum_j r_kj u_j, and c = sum_k a_k u_k."""

    u: Array  # (4, 3, 3) zero where a slot is empty or depends on the others
    r10: Array  # (4,)
    r20: Array
    r21: Array
    length: tuple[Array, Array, Array]  # (4,) each: r_kk, 1 where u_k is zero
    a: Array  # (4, 3) N


def unit_and_length(v: Array) -> tuple[Array, Array]:
    """Unit vectors and lengths of (4, 3); (zero, 1) where too short to be a direction."""
    length = jnp.sqrt(dot(v, v) + TINY)
    real = length > INDEPENDENT
    return jnp.where(real[:, None], v / length[:, None], 0.0), jnp.where(real, length, 1.0)


def orthonormal(faces: Faces) -> Basis:
    """Gram-Schmidt on the active rows of each leg, and the point on its faces nearest the origin."""
    g0, g1, g2 = faces.normal[:, 0], faces.normal[:, 1], faces.normal[:, 2]
    u0, n0 = unit_and_length(g0)
    r10, r20 = dot(g1, u0), dot(g2, u0)
    u1, n1 = unit_and_length(g1 - r10[:, None] * u0)
    r21 = dot(g2, u1)
    u2, n2 = unit_and_length(g2 - r20[:, None] * u0 - r21[:, None] * u1)
    a0 = faces.bound[:, 0]
    a1 = (faces.bound[:, 1] - r10 * a0) / n1
    a2 = (faces.bound[:, 2] - r20 * a0 - r21 * a1) / n2
    return Basis(jnp.stack([u0, u1, u2], 1), r10, r20, r21, (n0, n1, n2), jnp.stack([a0, a1, a2], 1))


def best_on_faces(problem: ForceProblem, basis: Basis, nu: Array) -> tuple[Array, Array, Array]:
    """Best force (4, 3) on the faces, its nu (6,), and how hard each u_k is pressed (4, 3)."""
    A, u, load, W = problem.A, basis.u, problem.load, problem.regularizer
    A_u = sum(A[:, :, None, k] * u[None, :, :, k] for k in range(3))  # (6, 4, 3)
    A_P = A - sum(A_u[:, :, k, None] * u[None, :, k] for k in range(3))
    A_P_load = A_P * load[None, :, None]
    M = jnp.maximum(W, FLOOR) * jnp.eye(6) + mm(A_P_load.reshape(6, 12), A_P.reshape(6, 12).T)
    c = mtv(u, basis.a) * (load > 0.0).astype(u.dtype)[:, None]

    def force(nu: Array) -> Array:
        # projected twice: A^T nu may be 1e7 times what must remain of it
        along = mtv(A_P_load.reshape(6, 12), nu).reshape(4, 3)
        return c + along - mtv(u, mv(u, along))

    # the last step's nu is refined, not thrown away
    missing = problem.b - weighted_wrench(problem, force(nu)) - W * nu
    nu = nu + solve_cholesky(cholesky(M), missing)
    best = force(nu)
    # the wrench that is missed balances the faces: W nu at the solution, but without nu's error
    missed = problem.b - weighted_wrench(problem, best)
    pressed = mtv(A_u.reshape(6, 12), missed).reshape(4, 3) - W * basis.a / jnp.where(load > 0.0, load, 1.0)[:, None]
    return best, nu, pressed


def multipliers(basis: Basis, pressed: Array) -> Array:
    """Multipliers (4, 3) of the active rows, by back substitution; > 0 presses at an upper bound."""
    n0, n1, n2 = basis.length
    m2 = pressed[:, 2] / n2
    m1 = (pressed[:, 1] - basis.r21 * m2) / n1
    m0 = (pressed[:, 0] - basis.r10 * m1 - basis.r20 * m2) / n0
    return jnp.stack([m0, m1, m2], 1)
