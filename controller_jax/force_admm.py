"""Unrolled ADMM for the force distribution: x carries the wrench, z the limits, y ties them (Boyd 2011; OSQP).

The wrench couples the legs through six numbers only, so the x-step needs a 3 x 3 inverse per leg and one 6 x 6
inverse (Woodbury), both made once per problem.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from controller_jax.force_problem import ForceProblem
from controller_jax.rotations import mm, mtv, mv
from controller_jax.small_linalg import inverse3, inverse_spd
from controller_jax.types import Array

# Measured best over random and recorded problems; the weights of the wrench are of order one.
PENALTY = 0.3
OVER_RELAXATION = 1.6


class AdmmResult(NamedTuple):
    """Last iterate."""

    force: Array  # (4, 3) x, N
    row_force: Array  # (4, 8) z, within the bounds, N
    multiplier: Array  # (4, 8) penalty * y, pushes down where positive


def admm(problem: ForceProblem, force: Array, multiplier: Array, iterations: int) -> AdmmResult:
    """Run a fixed number of iterations from a force (4, 3) and multipliers (4, 8)."""
    A, rows, lower, upper = problem.A, problem.rows, problem.lower, problem.upper
    supporting = problem.load > 0.0
    regularizer = problem.regularizer / jnp.where(supporting, problem.load, 1.0)
    gram = mm(jnp.swapaxes(rows, 1, 2), rows)
    D = PENALTY * gram + regularizer[:, None, None] * jnp.eye(3)[None]
    D_inverse = inverse3(D) * supporting[:, None, None]
    DA = mm(D_inverse, jnp.swapaxes(A, 1, 2))  # (4, 3, 6)
    M_inverse = inverse_spd(jnp.eye(6) + mm(A, DA).sum(0))

    def iterate(carry: tuple[Array, Array, Array], _: None) -> tuple[tuple[Array, Array, Array], None]:
        _, z, y = carry
        x = mv(D_inverse, PENALTY * mtv(rows, z - y))
        missing = problem.b - mv(A, x).sum(0)
        x = x + mv(DA, mv(M_inverse, missing)[None])
        relaxed = OVER_RELAXATION * mv(rows, x) + (1.0 - OVER_RELAXATION) * z
        z = jnp.clip(relaxed + y, lower, upper)
        return (x, z, y + relaxed - z), None

    start = (force, jnp.clip(mv(rows, force), lower, upper), multiplier / PENALTY)
    (x, z, y), _ = jax.lax.scan(iterate, start, None, length=iterations)
    return AdmmResult(x, z, PENALTY * y)
