"""Contact without corners: unilateral law and Coulomb's disc rounded, in the bodies' own Moreau step.

On a ground of tiny compliance the bodies' step asks for gap + h v_n >= 0 at its end whatever the gap at its middle:
there is no list of closed contacts that could change from one parameter value to the next. A foot that lands gets
just the impulse that brings it to the surface, so the motion is continuous in where within a step it lands. What is
left are the corner of the normal law and the edge of the friction disc, and those are rounded here.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp

from experiments.smooth.laws import Widths, shrink_to, softplus
from mjx_starleth.block_solve import apply, product, total, transpose
from mjx_starleth.contact import SWEEPS, ContactProblem, project

Array = jax.Array

COMPLIANCE = 1e-7  # m/N: 7 um under a standing robot's foot
TINY = 1e-12


def smooth_contacts(widths: Widths) -> Callable:
    """A solver in place of `mjx_starleth.contact.solve_contacts`."""
    return partial(_solve, widths)


def _solve(widths: Widths, problem: ContactProblem, impulse: Array, sweeps: int = SWEEPS) -> tuple[Array, Array]:
    """Impulses (4, 3) N s and how far they are from the hard laws, N s; block Gauss-Seidel as for the hard contact."""
    p = problem
    mutual = product(transpose(p.root), p.root)
    block = mutual + p.own

    def sweep(carry, _):
        momentum, impulse = carry
        for pair in (slice(0, 2), slice(2, 4)):
            root, old = p.root[pair], impulse[pair]
            seen = p.free_velocity[pair] + apply(transpose(root), momentum[None]) - apply(mutual[pair], old)
            new = _foot(widths, block[pair], p.friction[pair], seen)
            momentum = momentum + total(apply(root, new - old), 0)
            impulse = jnp.concatenate([new, impulse[2:]] if pair.start == 0 else [impulse[:2], new])
        return (momentum, impulse), None

    start = (total(apply(p.root, impulse), 0), impulse)
    (momentum, impulse), _ = jax.lax.scan(sweep, start, None, length=sweeps)
    velocity = p.free_velocity + apply(transpose(p.root), momentum[None]) + apply(p.own, impulse)
    scale = 3 / (block[:, 0, 0] + block[:, 1, 1] + block[:, 2, 2])
    off = project(impulse - scale[:, None] * velocity, p.friction) - impulse
    return impulse, jnp.sqrt(total(off * off).max() + TINY**2)


def _foot(widths: Widths, w: Array, friction: Array, velocity: Array) -> Array:
    """Impulse (feet, 3) of feet alone: normal law rounded, the sticking force shrunk into the rounded disc."""
    w_n = w[:, 2, 2]
    c1, c2 = w[:, 0, 2] / w_n, w[:, 1, 2] / w_n
    s11, s12, s22 = w[:, 0, 0] - c1 * w[:, 0, 2], w[:, 0, 1] - c1 * w[:, 1, 2], w[:, 1, 1] - c2 * w[:, 1, 2]
    s1, s2 = velocity[:, 0] - c1 * velocity[:, 2], velocity[:, 1] - c2 * velocity[:, 2]
    determinant = 1 / (s11 * s22 - s12 * s12)
    t1, t2 = (s12 * s2 - s22 * s1) * determinant, (s12 * s1 - s11 * s2) * determinant
    pressed = softplus(-velocity[:, 2] / w_n, widths.contact_impulse)
    shrink = shrink_to(jnp.sqrt(t1 * t1 + t2 * t2 + TINY**2), friction * pressed)
    t1, t2 = shrink * t1, shrink * t2
    normal = softplus(-velocity[:, 2] / w_n - c1 * t1 - c2 * t2, widths.contact_impulse)
    return jnp.stack([t1, t2, normal], -1)
