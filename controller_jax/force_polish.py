"""Active-set polish of the force distribution: from a feasible force to the exact optimum in a few steps.

Each step goes towards the best force on the faces (force_faces.py) as far as the bounds let it, each leg on its own
where that lowers the cost more, takes up the rows that stopped it, and frees a row that pulls. Forces stay feasible
and the cost falls with every step, so it ends at the optimum (primal active set; Nocedal & Wright, Numerical
Optimization, 16.5).
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from controller_jax.force_faces import Faces, best_on_faces, multipliers, orthonormal, unit_and_length
from controller_jax.force_problem import UNBOUNDED, ForceProblem, pull_inside, weighted_wrench
from controller_jax.rotations import TINY, dot, mtv, mv
from controller_jax.types import Array

PREDICTED = 0.05  # least part of a row off the others for it to be predicted active beside them
ON_FACE = 1e-3  # N, rounding allowed when a predicted face is tried
PULLING = 1e-5  # of the largest multiplier: more negative than rounding
MOVING = 1e-5  # of the step: less change than this of a row's force is rounding


class PolishResult(NamedTuple):
    """Feasible force and what is left to do."""

    force: Array  # (4, 3) N
    multiplier: Array  # (4, 8) as in the ADMM
    step_left: Array  # () largest distance from a leg's force to the optimum on its faces, N
    pull_left: Array  # () largest pull of a row still held, relative to the largest pressure
    cost: Array  # () half of eq. 6


class _Carry(NamedTuple):
    force: Array  # (4, 3)
    row_force: Array  # (4, 8) rows . force
    residual: Array  # (6,) A force - b
    nu: Array  # (6,)
    faces: Faces
    result: PolishResult


def polish(problem: ForceProblem, force: Array, multiplier: Array, steps: int) -> PolishResult:
    """Run a fixed number of steps from a force (4, 3) and the multipliers (4, 8) that foretell the active rows."""
    force, faces = _start(problem, force, multiplier)
    residual = weighted_wrench(problem, force) - problem.b
    unknown = jnp.asarray(UNBOUNDED)
    result = PolishResult(force, jnp.zeros((4, 8)), unknown, unknown, _cost(problem, force, residual))
    first = _Carry(force, mv(problem.rows, force), residual, jnp.zeros(6), faces, result)
    last, _ = jax.lax.scan(lambda carry, _: (_step(problem, carry), None), first, None, length=steps)
    return last.result


def _start(problem: ForceProblem, force: Array, multiplier: Array) -> tuple[Array, Faces]:
    """Each leg on the (at most three) rows that press most, if that is feasible there, else inside, on none."""
    pressing, free = jnp.abs(multiplier), jnp.ones((4, 8))
    rows, units = [], []
    on_faces = force
    for _ in range(3):
        score = jnp.where(free > PREDICTED**2, pressing * free, 0.0)
        row = _one_hot_largest(score) * (score.max(1) > 0.0).astype(score.dtype)[:, None]
        side = dot(row, jnp.sign(multiplier))
        normal = mtv(problem.rows, row)
        bound = dot(row, jnp.where(side[:, None] > 0.0, problem.upper, problem.lower))
        u = normal
        for v in units:
            u = u - dot(normal, v)[:, None] * v
        u, length = unit_and_length(u)
        on_faces = on_faces + ((bound - dot(normal, on_faces)) * side * side / length)[:, None] * u
        along = mv(problem.rows, u)
        free, pressing = free - along * along, pressing * (1.0 - row)
        units.append(u)
        rows.append((row, side, normal, bound))
    values = mv(problem.rows, on_faces)
    excess = jnp.maximum(values - problem.upper, problem.lower - values).max(1)
    feasible = excess < ON_FACE
    force = jnp.where(feasible[:, None], on_faces, pull_inside(problem, force))
    force = jnp.where(problem.load[:, None] > 0.0, force, 0.0)
    keep = (feasible & (problem.load > 0.0)).astype(force.dtype)
    faces = Faces(*(jnp.stack(parts, 1) for parts in zip(*rows, strict=True)))
    return force, jax.tree.map(lambda x: x * keep.reshape((4,) + (1,) * (x.ndim - 1)), faces)


def _step(problem: ForceProblem, carry: _Carry) -> _Carry:
    faces, force = carry.faces, carry.force
    basis = orthonormal(faces)
    best, nu, pressed = best_on_faces(problem, basis, carry.nu)
    d = best - force
    change = mv(problem.rows, d)
    ratio, row, direction = _first_bound(problem, carry, d, change)
    common = jnp.minimum(ratio.min(), 1.0)
    fraction = _fraction(problem, carry, d, jnp.minimum(ratio, 1.0), common)
    stopped = (ratio < 1.0) & (ratio <= fraction)

    pressure = multipliers(basis, pressed)
    scale = jnp.abs(pressure).max() + problem.regularizer * (jnp.abs(best).max() + 1.0)
    pull = -pressure * faces.side / scale
    freed = _one_hot_largest(pull) * ((pull > PULLING) & (common >= 1.0)).astype(pull.dtype)
    held = jax.tree.map(lambda x: x * (1.0 - freed).reshape((4, 3) + (1,) * (x.ndim - 2)), faces)
    taken = _take_up(problem, held, row, direction, stopped)

    step = fraction[:, None] * d
    moved = force + step
    residual = carry.residual + weighted_wrench(problem, step)
    cost = _cost(problem, moved, residual)
    now = PolishResult(moved, mtv(held.row, pressure), jnp.abs(d - step).max(), pull.max(), cost)
    better = cost <= carry.result.cost
    return _Carry(
        force=moved,
        row_force=carry.row_force + fraction[:, None] * change,
        residual=residual,
        nu=nu,
        faces=taken,
        result=jax.tree.map(lambda new, old: jnp.where(better, new, old), now, carry.result),
    )


def _first_bound(problem: ForceProblem, carry: _Carry, d: Array, change: Array) -> tuple[Array, Array, Array]:
    """How far each leg can go along d (4,), the row that stops it (4, 8), one-hot, and at which side (4,)."""
    room = jnp.where(change > 0.0, problem.upper - carry.row_force, carry.row_force - problem.lower)
    speed = jnp.abs(change)
    slots = carry.faces.row
    active = slots[:, 0] + slots[:, 1] + slots[:, 2]
    moving = (speed > MOVING * jnp.abs(d).max(1, keepdims=True) + TINY) & (active == 0.0)
    moving = moving & (problem.load > 0.0)[:, None]
    ratio = jnp.where(moving, jnp.maximum(room, 0.0) / jnp.where(moving, speed, 1.0), UNBOUNDED)
    row = _one_hot_largest(-ratio)
    return ratio.min(1), row, dot(row, jnp.sign(change))


def _cost(problem: ForceProblem, force: Array, residual: Array) -> Array:
    """Half of eq. 6, for the residual (6,) of the weighted wrench."""
    W = problem.regularizer / jnp.where(problem.load > 0.0, problem.load, 1.0)
    return 0.5 * (dot(residual, residual) + dot(W, dot(force, force)))


def _fraction(problem: ForceProblem, carry: _Carry, d: Array, alone: Array, common: Array) -> Array:
    """Part of d that each leg goes (4,): all alike, or each up to its own bound, whichever lowers the cost more."""
    W = problem.regularizer / jnp.where(problem.load > 0.0, problem.load, 1.0)
    wrench = sum(problem.A[:, :, k] * d[None, :, k] for k in range(3))  # (6, 4)
    linear, square = W * dot(carry.force, d), 0.5 * W * dot(d, d)

    def change(fraction: Array) -> Array:
        """Of the cost, half of eq. 6."""
        w = mv(wrench, fraction)
        return dot(w, carry.residual + 0.5 * w) + dot(fraction, linear + fraction * square)

    together = jnp.full(4, 1.0) * common
    return jnp.where(change(alone) < change(together), alone, together)


def _take_up(problem: ForceProblem, faces: Faces, row: Array, direction: Array, stopped: Array) -> Faces:
    """Put the rows (4, 8) that stopped a leg into its first empty slot."""
    empty = ((faces.side == 0.0) & stopped[:, None]).astype(row.dtype)
    second = empty[:, 1] * (1.0 - empty[:, 0])
    third = empty[:, 2] * (1.0 - empty[:, 0]) * (1.0 - empty[:, 1])
    slot = jnp.stack([empty[:, 0], second, third], 1)
    bound = dot(row, jnp.where(direction[:, None] > 0.0, problem.upper, problem.lower))
    return Faces(
        faces.row + slot[:, :, None] * row[:, None, :],
        faces.side + slot * direction[:, None],
        faces.normal + slot[:, :, None] * mtv(problem.rows, row)[:, None, :],
        faces.bound + slot * bound[:, None],
    )


def _one_hot_largest(score: Array) -> Array:
    """One-hot (..., n) of the first largest entry: entry by entry: with argmax the whole takes an eighth longer."""
    entries = [score[..., k] for k in range(score.shape[-1])]
    largest = functools.reduce(jnp.maximum, entries)
    free, hits = jnp.ones_like(largest), []
    for entry in entries:
        hits.append(free * (entry == largest).astype(score.dtype))
        free = free - hits[-1]
    return jnp.stack(hits, -1)
