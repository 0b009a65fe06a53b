"""Motion of a swing leg (V.A.4, V.B.2): from where it lifted off to its foothold, replanned at every tick.

Along the heading, across it and along the ground's normal the foot follows its own cubics in the swing phase,
each with zero velocity at its ends (timing: FACTS 3.4). The joints are position-controlled; their drives follow a
ramp with a lag, which leading the desired position by the desired velocity takes out.
"""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.leg_kinematics import LegKinematics, abduction, inverse_kinematics
from controller_jax.rotations import cross, mtv, mv
from controller_jax.terrain_estimator import Plane
from controller_jax.types import Array, LegGeometry, RobotState

APEX_PHASE = 0.5  # of the swing: middle knot of the height
SMALLEST_SHARE = 0.05  # of the swing, against division by zero at its end, where the rates are zero
SMALLEST_VOLUME = 1e-4  # m^3/rad^3, determinant of a leg's Jacobian; 4e-3 at the straightest allowed knee


class SwingParams(NamedTuple):
    """Shape of the swing."""

    apex_height: Array  # () of the sole above the ground, m
    landing_height: Array  # () the same at the planned touch-down, m; what is left the leg seeks at its own speed
    heading_end: Array  # () swing phase at which the foot is over its foothold along the heading
    lateral_start: Array  # () swing phase at which sideways motion begins
    lateral_end: Array  # () and ends
    position_lead: Array  # (3,) HAA HFE KFE, by which the position command runs ahead of the motion, s
    joint_speed_limit: Array  # () of the motion that is led, rad/s


class FootMotion(NamedTuple):
    """Desired motion of the soles in the world, (4, 3) each."""

    position: Array  # m
    velocity: Array  # m/s


def ease(x: Array) -> tuple[Array, Array]:
    """Cubic from 0 at x <= 0 to 1 at x >= 1 with zero slope at both ends, and its slope."""
    x = jnp.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x)


def swing_motion(
    params: SwingParams,
    lift_off_W: Array,
    foothold_W: Array,
    phase: Array,
    progress: Array,
    duration: Array,
    R_WC: Array,
    plane: Plane,
    clearance: Array,
) -> FootMotion:
    """Feet on their way from lift_off_W to foothold_W (4, 3).

    phase (4,) 0..1 through the planned swing, duration (4,) of it in s; progress (4,) 0..1 from the real lift-off on,
    which the horizontal motion follows; clearance (4,) m on top of the apex.
    """
    height_now = ((lift_off_W - plane.point_W[None]) * plane.normal_W[None]).sum(-1)
    height_end = ((foothold_W - plane.point_W[None]) * plane.normal_W[None]).sum(-1) + params.landing_height
    top = jnp.maximum(height_now, height_end) + params.apex_height + clearance
    heading, heading_rate = ease(progress / params.heading_end)
    window = params.lateral_end - params.lateral_start
    lateral, lateral_rate = ease((progress - params.lateral_start) / window)
    up, up_rate = ease(phase / APEX_PHASE)
    down, down_rate = ease((phase - APEX_PHASE) / (1.0 - APEX_PHASE))
    # what is left of the swing at lift-off: progress = 1 - (1 - phase) / left
    left = (1.0 - phase) / jnp.maximum(1.0 - progress, SMALLEST_SHARE)
    left = jnp.clip(left, SMALLEST_SHARE, 1.0)
    way_C = mtv(R_WC[None], foothold_W - lift_off_W)
    rise, drop = top - height_now, height_end - top
    moved = jnp.stack([way_C[:, 0] * heading, way_C[:, 1] * lateral, rise * up + drop * down], -1)
    rate = jnp.stack(
        [
            way_C[:, 0] * heading_rate / (params.heading_end * left),
            way_C[:, 1] * lateral_rate / (window * left),
            rise * up_rate / APEX_PHASE + drop * down_rate / (1.0 - APEX_PHASE),
        ],
        -1,
    )
    return FootMotion(lift_off_W + mv(R_WC[None], moved), mv(R_WC[None], rate / duration[:, None]))


def joint_positions(
    params: SwingParams,
    geometry: LegGeometry,
    state: RobotState,
    legs: LegKinematics,
    motion: FootMotion,
    normal_W: Array,
) -> Array:
    """Position commands (12,) that make the soles follow the motion, within the joint limits."""
    to_B = state.R_WB[None]
    centre = motion.position + geometry.foot_radius * normal_W[None]
    r_BF_B = mtv(to_B, centre - state.r_WB[None])
    omega = jnp.broadcast_to(state.omega_B, r_BF_B.shape)
    v_B = mtv(to_B, motion.velocity - state.v_WB[None]) - cross(omega, r_BF_B)
    qd = jnp.clip(solve_legs(legs.J_BF_B, v_B), -params.joint_speed_limit, params.joint_speed_limit)
    q = inverse_kinematics(geometry, within_stride_width(geometry, r_BF_B)).reshape(4, 3)
    # led before it is clamped: a target that comes back from beyond the stop leaves the hip there until it is due
    q = jnp.concatenate([abduction(geometry, r_BF_B)[:, None], q[:, 1:]], -1)
    q = (q + qd * params.position_lead[None]).reshape(12)
    return jnp.clip(q, geometry.position_limits[:, 0], geometry.position_limits[:, 1])


def within_stride_width(geometry: LegGeometry, r_BF_B: Array) -> Array:
    """Targets of the feet (4, 3) brought as near to the body's side as the HAA's stops demand, at their height.

    With the joint alone clamped, a leg as long as the way to the target would strike the ground before its time.
    """
    stops = jnp.tan(geometry.position_limits.reshape(4, 3, 2)[:, 0])
    y, height = r_BF_B[:, 1] - geometry.r_BH_B[:, 1], jnp.maximum(geometry.r_BH_B[:, 2] - r_BF_B[:, 2], 0.0)
    y = jnp.clip(y, height * stops[:, 0], height * stops[:, 1])
    return jnp.stack([r_BF_B[:, 0], geometry.r_BH_B[:, 1] + y, r_BF_B[:, 2]], -1)


def solve_legs(J: Array, v: Array) -> Array:
    """Joint velocities (4, 3) that give the feet the velocities v (4, 3) through their Jacobians (4, 3, 3)."""
    a, b, c = J[..., 0], J[..., 1], J[..., 2]
    bc = cross(b, c)
    volume = (a * bc).sum(-1, keepdims=True)
    volume = jnp.where(volume < 0.0, -1.0, 1.0) * jnp.maximum(jnp.abs(volume), SMALLEST_VOLUME)
    along = [(side * v).sum(-1, keepdims=True) for side in (bc, cross(c, a), cross(a, b))]
    return jnp.concatenate(along, -1) / volume
