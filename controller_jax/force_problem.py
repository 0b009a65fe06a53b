"""The quadratic program of the force distribution (eq. 6), written per leg, and its feasible set.

All forces, lever arms and wrenches are in the control frame C. Each leg has eight rows of unit length, row . force
between a lower and an upper bound: the normal force, the four sides of the friction pyramid, the three joint
torques. The rows of torque bind through the leg's own Jacobian, so nothing but the wrench couples the legs.
"""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.foot_contact import Soles
from controller_jax.joint_torques import weight_torque
from controller_jax.leg_kinematics import LegKinematics
from controller_jax.rotations import TINY, cross, dot, mm, mv, skew
from controller_jax.types import Array, LegGeometry

UNBOUNDED = 1e6  # N, stands for no bound: finite, so that no infinity meets a zero
RAY_SLACK = 200.0  # N, how far up a ray the interior point is looked for


class DistributionSettings(NamedTuple):
    """Weights and limits of eq. 6 (FACTS 3.2)."""

    wrench_weight: Array  # (6,) diagonal of S: force x y z, torque roll pitch yaw
    regularizer: Array  # () W = regularizer * identity
    friction: Array  # () mu of the pyramid
    minimal_normal: Array  # () least normal force of a support leg, N
    torque_limits: Array  # (12, 2) N m


class SupportLegs(NamedTuple):
    """The legs as the distribution sees them, in the control frame."""

    r_BF_C: Array  # (4, 3) torso origin to foot, m
    J_BF_C: Array  # (4, 3, 3) m/rad
    weight_torque: Array  # (4, 3) joint torque that holds the leg's own weight, N m
    load: Array  # (4,) 1 for a support leg, 0 for a leg in the air; between, it shares the load in proportion


def support_legs(
    geometry: LegGeometry, legs: LegKinematics, R_WB: Array, R_WC: Array, load: Array, feet: Soles | None = None
) -> SupportLegs:
    """The legs in the control frame, under loads (4,).

    With `feet`, the ground's forces act at the soles, where they do, and not at the centres of the feet: on a slope
    of 21 degrees, under an upright force, that is 7 mm of lever arm apart.
    """
    R_CB = mm(R_WC.T, R_WB)
    weight = weight_torque(geometry, legs, R_WB)
    r_B, J_B = (legs.r_BF_B, legs.J_BF_B) if feet is None else (feet.r_BS_B, feet.J_BS_B)
    return SupportLegs(mv(R_CB[None], r_B), mm(R_CB[None], J_B), weight, load)


class ForceProblem(NamedTuple):
    """min |A force - b|^2 + regularizer sum |force_i|^2 / load_i  subject to  lower <= rows force <= upper."""

    A: Array  # (6, 4, 3) weighted wrench of a force on each foot, 0 for a leg in the air
    b: Array  # (6,) weighted desired wrench
    rows: Array  # (4, 8, 3) unit rows
    lower: Array  # (4, 8) N
    upper: Array  # (4, 8) N
    load: Array  # (4,)
    regularizer: Array  # ()
    interior: Array  # (4, 3) a point inside each leg's feasible set, N


def force_problem(settings: DistributionSettings, legs: SupportLegs, wrench_C: Array) -> ForceProblem:
    """Set up eq. 6 for the desired wrench (6,) on the torso about its origin.

    A leg whose minimal normal force breaks a torque limit has that limit moved to what the force needs: there is
    always a feasible force, the pyramid and the minimal normal force hold in any case.
    """
    weight = jnp.sqrt(settings.wrench_weight)
    forces = jnp.broadcast_to(jnp.eye(3)[:, None], (3, 4, 3))
    wrench_of_force = jnp.concatenate([forces, jnp.swapaxes(skew(legs.r_BF_C), 0, 1)])
    supporting = (legs.load > 0.0).astype(legs.load.dtype)
    A = weight[:, None, None] * wrench_of_force * supporting[None, :, None]

    columns = jnp.swapaxes(legs.J_BF_C, 1, 2)
    length = jnp.sqrt(dot(columns, columns) + TINY)  # (4, 3)
    torque_rows = columns / length[:, :, None]
    limits = settings.torque_limits.reshape(4, 3, 2)
    # torque = weight_torque - J^T force (eq. 7) within its limits
    torque_lower = (legs.weight_torque - limits[:, :, 1]) / length
    torque_upper = (legs.weight_torque - limits[:, :, 0]) / length

    rows = jnp.concatenate([jnp.broadcast_to(_pyramid(settings.friction), (4, 5, 3)), torque_rows], 1)
    minimal = settings.minimal_normal * legs.load
    lower = jnp.concatenate([minimal[:, None], jnp.zeros((4, 4)), torque_lower], 1)
    upper = jnp.concatenate([jnp.full((4, 5), UNBOUNDED), torque_upper], 1)
    interior = _interior(settings.friction, minimal, legs.J_BF_C, rows, lower, upper)
    at_interior = mv(rows, interior)
    return ForceProblem(
        A=A,
        b=weight * wrench_C,
        rows=rows,
        lower=jnp.minimum(lower, at_interior),
        upper=jnp.maximum(upper, at_interior),
        load=legs.load,
        regularizer=settings.regularizer,
        interior=interior,
    )


def _pyramid(friction: Array) -> Array:
    """Rows (5, 3) of the normal force and of friction * normal +- tangential, unit length."""
    sides = jnp.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    normal = jnp.array([[0.0, 0.0, 1.0]])
    return jnp.concatenate([normal, (sides + friction * normal) / jnp.sqrt(1.0 + friction * friction)])


def _interior(friction: Array, minimal: Array, J: Array, rows: Array, lower: Array, upper: Array) -> Array:
    """A feasible force per leg (4, 3): the middle of what is allowed along the better of two rays.

    The rays are the normal and the line of the leg (no torque at the hip), bent into the friction pyramid.
    """
    line = cross(J[:, :, 0], J[:, :, 1])  # no torque in HAA and HFE
    line = line * jnp.sign(line[:, 2:])
    normal = jnp.maximum(line[:, 2:], TINY)
    slope = line[:, :2] / normal
    side = 0.7 * friction
    bend = jnp.clip(slope, -side, side)
    rays = jnp.stack([jnp.zeros((4, 2)), bend], 1)  # tangential part per unit of normal force, (4, 2, 2)
    rays = jnp.concatenate([rays, jnp.ones((4, 2, 1))], -1)
    along = mv(rows[:, None], rays)  # (4, 2, 8)
    safe = jnp.where(jnp.abs(along) > TINY, along, TINY)
    ends = jnp.stack([lower[:, None] / safe, upper[:, None] / safe])  # (2, 4, 2, 8)
    start = jnp.maximum(ends.min(0).max(-1), minimal[:, None])  # (4, 2)
    room = jnp.minimum(ends.max(0).min(-1) - start, RAY_SLACK)
    better = room[:, :1] >= room[:, 1:]
    room, start = (jnp.where(better[:, 0], v[:, 0], v[:, 1]) for v in (room, start))
    ray = jnp.where(better, rays[:, 0], rays[:, 1])
    height = jnp.where(room > 0.0, start + 0.5 * room, minimal)
    return ray * height[:, None]


def weighted_wrench(problem: ForceProblem, force: Array) -> Array:
    """A force (6,) of forces (4, 3)."""
    return mv(problem.A.reshape(6, 12), force.reshape(12))


def pull_inside(problem: ForceProblem, force: Array) -> Array:
    """Force (4, 3) moved towards the interior point just as far as makes every row hold; 0 for legs in the air."""
    at_interior = mv(problem.rows, problem.interior)
    change = mv(problem.rows, force - problem.interior)
    room = jnp.where(change > 0.0, problem.upper - at_interior, at_interior - problem.lower)
    fraction = jnp.clip((room / jnp.maximum(jnp.abs(change), TINY)).min(1), 0.0, 1.0)
    inside = problem.interior + fraction[:, None] * (force - problem.interior)
    return jnp.where(problem.load[:, None] > 0.0, inside, 0.0)
