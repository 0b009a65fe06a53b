"""Four contacts with set-valued laws (paper II): unilateral normal cone, spatial Coulomb friction, Newton's impact.

In each foot's contact frame [t1 t2 n], with the velocity v = free_velocity + W impulse:

    0 <= impulse_n  _|_  v_n >= 0             free_velocity_n holds the impact law's share e v_n^-
    impulse_t = -mu impulse_n v_t / |v_t|     |impulse_t| <= mu impulse_n where v_t = 0

Non-linear block Gauss-Seidel (Jean, Comput. Methods Appl. Mech. Eng. 177 (1999) 235): each foot's own law is solved
exactly with the others held, fore feet at once, then hind feet at once. Two feet at once converge as surely as one,
because W is positive semi-definite; four at once would not on stiff legs.

A foot's law is one scalar equation. Sliding means v_t = -kappa impulse_t with kappa > 0, sticking kappa = 0, so
impulse_t(kappa) = -(S + kappa)^-1 s, and kappa >= 0 is sought where mu impulse_n / |impulse_t| reaches 1. That ratio
is a straight line in kappa if S is isotropic; Newton's method starts from the line's root, in later sweeps where the
last one left it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from mjx_starleth.block_solve import apply, product, total, transpose

Array = jax.Array

SWEEPS = 3
NEWTON_STEPS = 2
TINY = 1e-12  # keeps divisions finite, far below any impulse (N s) or inverse inertia (1/kg) that matters


class ContactProblem(NamedTuple):
    """Contacts of four feet in their frames; the operational inverse inertia is W_ij = G_i^T G_j + delta_ij D_i."""

    root: Array  # (4, 6, 3) G, kg^-1/2
    own: Array  # (4, 3, 3) D: the leg's part and the ground's compliance, 1/kg
    free_velocity: Array  # (4, 3) without impulses, impact law included, m/s
    friction: Array  # (4,)
    closed: Array  # (4,) 1.0 or 0.0


class Foot(NamedTuple):
    """One foot's law with the normal impulse eliminated; every array (feet,)."""

    closed: Array
    friction: Array
    w_n: Array  # 1/kg
    c: tuple[Array, Array]  # normal-tangential coupling over w_n
    s11: Array  # tangential inverse inertia at zero normal velocity, 1/kg
    s12: Array
    s22: Array


def solve_contacts(problem: ContactProblem, impulse: Array, sweeps: int = SWEEPS) -> tuple[Array, Array]:
    """Impulses (4, 3) N s in the contact frames, and the largest violation of the laws by any foot, N s.

    impulse: first guess, (4, 3). The violation is the distance of an impulse to its own image under the proximal
    point map of the laws, impulse -> proj(impulse - v / w), which is zero exactly at a solution.
    """
    p = problem
    mutual = product(transpose(p.root), p.root)
    block = mutual + p.own
    feet = _feet(p, block)
    pairs = [jax.tree.map(lambda x, k=k: x[k : k + 2], (p.root, mutual, p.free_velocity, feet)) for k in (0, 2)]

    def sweep(carry, _):
        momentum, guesses, kappas = carry
        solved, slipping = [], []
        for (root, mutual, free, foot), guess, kappa in zip(pairs, guesses, kappas, strict=True):
            seen = free + apply(transpose(root), momentum[None]) - apply(mutual, guess)
            new, kappa = _solve_foot(foot, seen, kappa)
            momentum = momentum + total(apply(root, new - guess), 0)
            solved.append(new)
            slipping.append(kappa)
        return (momentum, tuple(solved), tuple(slipping)), None

    impulse = impulse * p.closed[:, None]
    sticking = jnp.zeros(2, impulse.dtype)
    start = (total(apply(p.root, impulse), 0), (impulse[:2], impulse[2:]), (sticking, sticking))
    (momentum, solved, _), _ = jax.lax.scan(sweep, start, None, length=sweeps)
    impulse = jnp.concatenate(solved)
    velocity = p.free_velocity + apply(transpose(p.root), momentum[None]) + apply(p.own, impulse)
    scale = 3 / (block[:, 0, 0] + block[:, 1, 1] + block[:, 2, 2])
    off = p.closed[:, None] * (project(impulse - scale[:, None] * velocity, p.friction) - impulse)
    return impulse, jnp.sqrt(total(off * off).max())


def project(impulse: Array, friction: Array) -> Array:
    """Nearest admissible impulse (..., 3): half line along the normal, then the Coulomb disc."""
    t1, t2, n = impulse[..., 0], impulse[..., 1], jnp.maximum(impulse[..., 2], 0)
    shrink = jnp.minimum(1, friction * n * jax.lax.rsqrt(t1 * t1 + t2 * t2 + TINY**2))
    return jnp.stack([shrink * t1, shrink * t2, n], -1)


def _feet(p: ContactProblem, w: Array) -> Foot:
    w_n = w[:, 2, 2]
    c1, c2 = w[:, 0, 2] / w_n, w[:, 1, 2] / w_n
    return Foot(
        closed=p.closed,
        friction=p.friction,
        w_n=w_n,
        c=(c1, c2),
        s11=w[:, 0, 0] - c1 * w[:, 0, 2],
        s12=w[:, 0, 1] - c1 * w[:, 1, 2],
        s22=w[:, 1, 1] - c2 * w[:, 1, 2],
    )


def _solve_foot(foot: Foot, velocity: Array, guess: Array) -> tuple[Array, Array]:
    """Impulse (feet, 3) that fulfils the laws of each foot alone, and its kappa (feet,), 1/kg.

    velocity (feet, 3) is that without the foot's impulse; guess of kappa (feet,), 0 where there is none.
    """
    (c1, c2), mu = foot.c, foot.friction
    pressed = jnp.maximum(-velocity[:, 2] / foot.w_n, TINY)  # normal impulse without friction
    s1, s2 = velocity[:, 0] - c1 * velocity[:, 2], velocity[:, 1] - c2 * velocity[:, 2]

    size2 = s1 * s1 + s2 * s2 + TINY**2
    rayleigh = (foot.s11 * s1 * s1 + 2 * foot.s12 * s1 * s2 + foot.s22 * s2 * s2) / size2
    line = (jnp.sqrt(size2) - mu * (c1 * s1 + c2 * s2)) / (mu * pressed + TINY)
    most = 1e4 * (foot.s11 + foot.s22)  # as good as frictionless
    kappa = jnp.where(guess > 0, guess, jnp.clip(line - rayleigh, 0, most))

    for _ in range(NEWTON_STEPS):
        a, b = foot.s11 + kappa, foot.s22 + kappa
        determinant = 1 / (a * b - foot.s12 * foot.s12)
        t1, t2 = (foot.s12 * s2 - b * s1) * determinant, (foot.s12 * s1 - a * s2) * determinant
        d1, d2 = (foot.s12 * t2 - b * t1) * determinant, (foot.s12 * t1 - a * t2) * determinant  # d t / d kappa
        size2 = t1 * t1 + t2 * t2 + TINY**2
        limit = mu * (pressed - c1 * t1 - c2 * t2)
        slope = -mu * (c1 * d1 + c2 * d2) - limit * (t1 * d1 + t2 * d2) / size2
        kappa = jnp.clip(kappa - (limit - jnp.sqrt(size2)) / jnp.maximum(slope, TINY), 0, most)

    a, b = foot.s11 + kappa, foot.s22 + kappa
    determinant = 1 / (a * b - foot.s12 * foot.s12)
    t1, t2 = (foot.s12 * s2 - b * s1) * determinant, (foot.s12 * s1 - a * s2) * determinant
    held = jnp.where(velocity[:, 2] < 0, foot.closed, 0)
    return held[:, None] * project(jnp.stack([t1, t2, pressed - c1 * t1 - c2 * t2], -1), mu), kappa
