"""Four contacts with set-valued laws, solved by proximal Gauss-Seidel sweeps (Moreau; Studer; paper II).

For each closed contact, with the velocity v = v_free + W impulse + (compliance / h^2) (n n^T) impulse:
    normal cone       v_n + e v_n^-  in  N_{R+}(impulse_n)        unilateral, Newton's impact law
    spatial Coulomb   v_t            in  N_{disc(mu impulse_n)}(impulse_t)
each written as impulse = prox(impulse - r v), which holds exactly at the solution and is iterated to get there.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from mjx_starleth.block_solve import apply, product, transpose

Array = jax.Array


class ContactProblem(NamedTuple):
    """Contacts of four feet in world axes; the operational inverse inertia is W_ij = G_i^T G_j + delta_ij D_i."""

    root: Array  # (4, 6, 3) G
    local: Array  # (4, 3, 3) D, legs' own and the ground's compliance
    free_velocity: Array  # (4, 3) relative velocity without impulses plus the restitution's target, m/s
    normal: Array  # (4, 3)
    friction: Array  # (4,)
    closed: Array  # (4,) 1.0 or 0.0


def project(impulse: Array, normal: Array, friction: Array) -> Array:
    """Nearest admissible impulse: half line along the normal, then the Coulomb disc. Last axis 3."""
    pressed = (impulse * normal).sum(-1)
    tangent = impulse - pressed[..., None] * normal
    pressed = jnp.maximum(pressed, 0)
    size = jnp.sqrt((tangent * tangent).sum(-1) + 1e-20)
    scale = jnp.minimum(1, friction * pressed / size)
    return pressed[..., None] * normal + scale[..., None] * tangent


def solve_contacts(problem: ContactProblem, impulse: Array, sweeps: int) -> tuple[Array, Array]:
    """Impulses (4, 3) N s from a first guess, and by how much the laws are violated, N s (largest of the contacts)."""
    p = problem
    diagonal = product(transpose(p.root), p.root) + p.local
    step = 1.5 / (diagonal[:, 0, 0] + diagonal[:, 1, 1] + diagonal[:, 2, 2])

    def sweep(carry, _):
        impulse, momentum = carry
        for i in range(4):
            velocity = (
                p.free_velocity[i] + apply(transpose(p.root[i]), momentum) + apply(p.local[i], impulse[i])
            )
            new = p.closed[i] * project(impulse[i] - step[i] * velocity, p.normal[i], p.friction[i])
            momentum = momentum + apply(p.root[i], new - impulse[i])
            impulse = impulse.at[i].set(new)
        return (impulse, momentum), None

    impulse = impulse * p.closed[:, None]
    momentum = apply(p.root, impulse).sum(0)
    (impulse, momentum), _ = jax.lax.scan(sweep, (impulse, momentum), None, length=sweeps)
    velocity = p.free_velocity + apply(transpose(p.root), momentum[None]) + apply(p.local, impulse)
    wanted = p.closed[:, None] * project(impulse - step[:, None] * velocity, p.normal, p.friction)
    return impulse, jnp.sqrt(((wanted - impulse) ** 2).sum(-1).max())
