"""Active-set polish of the force distribution: from a feasible force to the exact optimum in a few steps.

With the active rows of each leg orthonormalised (u_k), c the point on its faces nearest the origin and
P = I - sum u u^T, the best force on the faces is (Woodbury, in the six numbers of the wrench)

    force = c + load P A^T nu,    (W I + sum A load P A^T) nu = b - A c.

Each step goes there as far as the bounds let it, each leg on its own where that lowers the cost more, takes up the
rows that stopped it, and frees rows that pull. Forces stay feasible and the cost falls with every step, so it ends
at the optimum (primal active set; Nocedal & Wright, Numerical Optimization, 16.5).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from controller_jax.force_problem import UNBOUNDED, ForceProblem, pull_inside
from controller_jax.rotations import TINY, mm, mtv, mv
from controller_jax.small_linalg import solve_spd
from controller_jax.types import Array

INDEPENDENT = 1e-3  # least length of a unit row off the others for it to count as a new direction
ON_FACE = 1e-3  # N, rounding allowed when a predicted face is tried
PULLING = 1e-5  # relative to the forces in balance: a multiplier more negative than rounding


class Faces(NamedTuple):
    """Up to three active rows per leg."""

    slots: Array  # (4, 3, 8) which row each slot holds, one-hot, zero if empty
    side: Array  # (4, 3) +1 at the upper bound, -1 at the lower, 0 empty


class Basis(NamedTuple):
    """The active rows orthonormalised: row_k = sum_j r_kj u_j."""

    u: Array  # (4, 3, 3) unit vectors, zero where a slot is empty or depends on the others
    r10: Array  # (4,)
    r20: Array
    r21: Array
    length: Array  # (4, 3) r_kk, 1 where u_k is zero
    nearest: Array  # (4, 3) c


class PolishResult(NamedTuple):
    """Feasible force and what is left to do."""

    force: Array  # (4, 3) N
    multiplier: Array  # (4, 8) as in the ADMM
    step_left: Array  # () largest distance from a leg's force to the optimum on its faces, N
    pull_left: Array  # () largest pull of a row still held, relative to the forces in balance


def polish(problem: ForceProblem, force: Array, row_force: Array, multiplier: Array, steps: int) -> PolishResult:
    """Run a fixed number of active-set steps from what the ADMM found: force (4, 3), rows and multipliers (4, 8)."""
    faces = _predicted_faces(problem, row_force, multiplier)
    basis = _basis(problem, faces)
    on_faces = force - mtv(basis.u, mv(basis.u, force)) + basis.nearest
    values = mv(problem.rows, on_faces)
    feasible = ((values >= problem.lower - ON_FACE) & (values <= problem.upper + ON_FACE)).all(1)
    force = jnp.where(feasible[:, None], on_faces, pull_inside(problem, force))
    force = jnp.where(problem.load[:, None] > 0.0, force, 0.0)
    keep = feasible.astype(force.dtype)
    faces = Faces(faces.slots * keep[:, None, None], faces.side * keep[:, None])
    zero = jnp.zeros(())
    carry = (PolishResult(force, jnp.zeros((4, 8)), zero, zero), faces, jnp.zeros(6))
    carry, _ = jax.lax.scan(lambda c, _: (_step(problem, *c), None), carry, None, length=steps)
    return carry[0]


def _predicted_faces(problem: ForceProblem, row_force: Array, multiplier: Array) -> Faces:
    """The (at most three) rows at a bound that press most, independent of each other."""
    at_bound = (row_force <= problem.lower) | (row_force >= problem.upper)
    pressing = jnp.where(at_bound, jnp.abs(multiplier), 0.0)
    free = problem.rows
    slots, sides = [], []
    for _ in range(3):
        length2 = (free * free).sum(-1)
        score = jnp.where(length2 > 2.5e-3, pressing * length2, 0.0)
        chosen = _one_hot_largest(score) * (score.max(1) > 0.0)[:, None]
        u = mtv(free, chosen)
        u = u / jnp.sqrt((u * u).sum(-1, keepdims=True) + TINY)
        free = free - mv(free, u)[:, :, None] * u[:, None, :]
        pressing = pressing * (1.0 - chosen)
        slots.append(chosen)
        sides.append((chosen * jnp.sign(multiplier)).sum(-1))
    return Faces(jnp.stack(slots, 1), jnp.stack(sides, 1))


def _basis(problem: ForceProblem, faces: Faces) -> Basis:
    """Gram-Schmidt on the active rows of each leg, and the point on its faces nearest the origin."""
    g = mm(faces.slots, problem.rows)
    bound = jnp.where(faces.side[:, :, None] > 0.0, problem.upper[:, None], problem.lower[:, None])
    bound = (faces.slots * bound).sum(-1)
    g0, g1, g2 = g[:, 0], g[:, 1], g[:, 2]
    u0, n0 = _unit(g0)
    r10, r20 = (g1 * u0).sum(-1), (g2 * u0).sum(-1)
    u1, n1 = _unit(g1 - r10[:, None] * u0)
    r21 = (g2 * u1).sum(-1)
    u2, n2 = _unit(g2 - r20[:, None] * u0 - r21[:, None] * u1)
    a0 = bound[:, 0]
    a1 = (bound[:, 1] - r10 * a0) / n1
    a2 = (bound[:, 2] - r20 * a0 - r21 * a1) / n2
    u = jnp.stack([u0, u1, u2], 1)
    nearest = mtv(u, jnp.stack([a0, a1, a2], -1))
    return Basis(u, r10, r20, r21, jnp.stack([n0, n1, n2], -1), nearest)


def _unit(v: Array) -> tuple[Array, Array]:
    """Unit vectors and lengths of (4, 3); (zero, 1) where too short to be a direction."""
    length = jnp.sqrt((v * v).sum(-1) + TINY)
    real = length > INDEPENDENT
    return jnp.where(real[:, None], v / length[:, None], 0.0), jnp.where(real, length, 1.0)


def _along_faces(u: Array, v: Array) -> Array:
    """P v; twice, because v may be 1e7 times what must remain of it."""
    v = v - mtv(u, mv(u, v))
    return v - mtv(u, mv(u, v))


def _step(problem: ForceProblem, so_far: PolishResult, faces: Faces, nu: Array):
    force = so_far.force
    A, load, W = problem.A, problem.load, problem.regularizer
    basis = _basis(problem, faces)
    u = basis.u
    P = (jnp.eye(3)[None] - mm(jnp.swapaxes(u, 1, 2), u)) * load[:, None, None]
    PA = mm(P, jnp.swapaxes(A, 1, 2))
    M = W * jnp.eye(6) + mm(A, PA).sum(0)
    # nu of the last step, refined: float32 alone would leave 1 % where W is 1e-5 of the rest
    start = basis.nearest * (load > 0.0)[:, None] + load[:, None] * _along_faces(u, mtv(A, nu[None]))
    missing = problem.b - mv(A, start).sum(0) - W * nu
    nu = nu + solve_spd(M, missing[:, None])[:, 0]
    balance = mtv(A, nu[None])
    best = basis.nearest * (load > 0.0)[:, None] + load[:, None] * _along_faces(u, balance)
    d = best - force

    ratio, blocking, direction = _first_bound(problem, faces, force, d)
    common = jnp.minimum(ratio.min(), 1.0)
    alone = jnp.minimum(ratio, 1.0)
    own_way = _change(problem, force, alone[:, None] * d) < _change(problem, force, common * d)
    fraction = jnp.where(own_way, alone, common)
    stopped = (ratio < 1.0) & (own_way | (ratio <= common))
    arrived = common >= 1.0

    inverse_load = 1.0 / jnp.where(load > 0.0, load, 1.0)
    pressure = _pressure(basis, balance - best * inverse_load[:, None])
    pull = -pressure * faces.side / (jnp.abs(balance).max() + jnp.abs(best).max() + 1.0)
    freed = _one_hot_largest(pull) * (pull > PULLING) * arrived
    held = Faces(faces.slots * (1.0 - freed)[:, :, None], faces.side * (1.0 - freed))
    after = _take_up(held, blocking, direction, stopped)
    step_left = jnp.abs(best - force - fraction[:, None] * d).max()
    multiplier = problem.regularizer * (pressure[:, :, None] * held.slots).sum(1)
    return PolishResult(force + fraction[:, None] * d, multiplier, step_left, pull.max()), after, nu


def _first_bound(problem: ForceProblem, faces: Faces, force: Array, d: Array) -> tuple[Array, Array, Array]:
    """How far each leg can go along d (4,), the row that stops it (4, 8), one-hot, and at which side (4,)."""
    value, change = mv(problem.rows, force), mv(problem.rows, d)
    room = jnp.maximum(jnp.where(change > 0.0, problem.upper - value, value - problem.lower), 0.0)
    moving = jnp.abs(change) > 1e-5 * jnp.abs(d).max(1, keepdims=True) + TINY
    can_stop = moving & (faces.slots.sum(1) == 0.0) & (problem.load > 0.0)[:, None]
    ratio = jnp.where(can_stop, room / jnp.where(moving, jnp.abs(change), 1.0), UNBOUNDED)
    row = _one_hot_largest(-ratio)
    return ratio.min(1), row, (row * jnp.sign(change)).sum(1)


def _change(problem: ForceProblem, force: Array, d: Array) -> Array:
    """Change of the cost (half of eq. 6) by a step d (4, 3)."""
    inverse_load = 1.0 / jnp.where(problem.load > 0.0, problem.load, 1.0)
    W = problem.regularizer * inverse_load[:, None]
    residual = mv(problem.A, force).sum(0) - problem.b
    wrench = mv(problem.A, d).sum(0)
    return (wrench * (residual + 0.5 * wrench)).sum() + (W * d * (force + 0.5 * d)).sum()


def _pressure(basis: Basis, t: Array) -> Array:
    """Multipliers (4, 3), over W, of the active rows: t = sum_k pressure_k row_k by back substitution."""
    t = mv(basis.u, t)
    m2 = t[:, 2] / basis.length[:, 2]
    m1 = (t[:, 1] - basis.r21 * m2) / basis.length[:, 1]
    m0 = (t[:, 0] - basis.r10 * m1 - basis.r20 * m2) / basis.length[:, 0]
    return jnp.stack([m0, m1, m2], -1)


def _take_up(faces: Faces, row: Array, direction: Array, stopped: Array) -> Faces:
    """Put the rows (4, 8) of the stopped legs into their first empty slots."""
    empty = (faces.side == 0.0).astype(row.dtype)
    taken = 1.0 - empty
    first = jnp.stack([empty[:, 0], empty[:, 1] * taken[:, 0], empty[:, 2] * taken[:, 0] * taken[:, 1]], 1)
    first = first * stopped[:, None]
    slots = faces.slots + first[:, :, None] * row[:, None, :]
    return Faces(slots, faces.side + first * direction[:, None])


def _one_hot_largest(score: Array) -> Array:
    """One-hot (..., n) of the (first) largest entry."""
    index = jnp.arange(score.shape[-1])
    best = jnp.argmax(score, -1, keepdims=True)
    return (index.reshape((1,) * (score.ndim - 1) + (-1,)) == best).astype(score.dtype)
