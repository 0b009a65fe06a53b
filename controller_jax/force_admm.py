"""Unrolled ADMM for the force distribution: x carries the wrench, z the limits, y ties them (Boyd 2011; OSQP).

The wrench couples the legs through six numbers only, so the x-step needs a 3 x 3 inverse per leg and one 6 x 6
factor (Woodbury), both made once per problem: with D = W + penalty rows^T rows and M = I + A D^-1 A^T,

    x = x_D + D^-1 A^T M^-1 (b - A x_D),    x_D = penalty D^-1 rows^T (z - y).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from controller_jax.force_problem import ForceProblem, weighted_wrench
from controller_jax.rotations import mm, mtv, mv
from controller_jax.small_linalg import cholesky, inverse3, solve_cholesky
from controller_jax.types import Array

# Measured best over random and recorded problems; the weights of the wrench are of order one.
PENALTY = 0.3
OVER_RELAXATION = 1.6


class AdmmResult(NamedTuple):
    """Last iterate."""

    force: Array  # (4, 3) x, N
    multiplier: Array  # (4, 8) penalty * y: how hard a row presses, > 0 at its upper bound


def admm(
    problem: ForceProblem, force: Array, multiplier: Array, iterations: int, clip: Callable[..., Array] = jnp.clip
) -> AdmmResult:
    """Run a fixed number of iterations from a force (4, 3) and multipliers (4, 8).

    clip(x, lower, upper) is the projection onto the limits; a rounded one makes the force a smooth function.
    """
    rows, A, load = problem.rows, problem.A, problem.load
    W = problem.regularizer / jnp.where(load > 0.0, load, 1.0)
    rows_T = jnp.swapaxes(rows, 1, 2)
    D = PENALTY * mm(rows_T, rows) + W[:, None, None] * jnp.eye(3)[None]
    D_inverse = inverse3(D) * (load > 0.0).astype(D.dtype)[:, None, None]
    AD = sum(A[:, :, k, None] * D_inverse[None, :, k] for k in range(3)).reshape(6, 12)  # A D^-1
    L = cholesky(jnp.eye(6) + mm(AD, A.reshape(6, 12).T))
    correction = solve_cholesky(L, AD)  # M^-1 A D^-1

    def x_step(pull: Array) -> Array:
        x = mv(D_inverse, mtv(rows, PENALTY * pull))
        return x + mtv(correction, problem.b - weighted_wrench(problem, x)).reshape(4, 3)

    def iterate(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        z, y = carry
        relaxed = OVER_RELAXATION * mv(rows, x_step(z - y)) + (1.0 - OVER_RELAXATION) * z
        z = clip(relaxed + y, problem.lower, problem.upper)
        return (z, y + relaxed - z), None

    start = (clip(mv(rows, force), problem.lower, problem.upper), multiplier / PENALTY)
    (z, y), _ = jax.lax.scan(iterate, start, None, length=iterations)
    return AdmmResult(x_step(z - y), PENALTY * y)
