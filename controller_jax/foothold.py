"""Where a swing leg should land (V.A.4): under the hip, ahead by the speed, corrected for balance."""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.geometry import LEFT_SIGN
from controller_jax.rotations import cross, mtv, mv
from controller_jax.terrain_estimator import Plane, height_at
from controller_jax.types import Array, LegGeometry, RobotState
from controller_jax.velocity_command import VelocityCommand


class FootholdParams(NamedTuple):
    """How footholds are chosen."""

    lever: Array  # () 0: telescopic strut, hip projected along gravity; 1: lever, along the slope's normal
    feed_forward: Array  # () share of the way travelled in stance by which the foot lands ahead
    feedback: Array  # (2,) k_FB of eq. 4 for the heading and the lateral velocity
    heading_offset: Array  # (2,) fore, hind, forwards, m
    lateral_offset: Array  # (2,) fore, hind, outwards, m
    reach: Array  # () largest distance from the projected hip along either axis, share of the leg length


def desired_footholds(
    params: FootholdParams,
    geometry: LegGeometry,
    state: RobotState,
    R_WC: Array,
    plane: Plane,
    command: VelocityCommand,
    stance_duration: Array,
    time_to_touch_down: Array,
) -> Array:
    """Points of the ground plane (4, 3), world frame, where the legs should land.

    stance_duration, time_to_touch_down: (4,) s.
    """
    r_BH_W = mv(state.R_WB[None], geometry.r_BH_B)
    hips = state.r_WB[None] + r_BH_W
    height = jnp.maximum(hips[:, 2] - height_at(plane, hips), 0.0)
    strut, lever = _below(hips, plane, height)
    start_W = strut + params.lever * (lever - strut)

    to_C = R_WC[None]
    r_BH_C = mtv(to_C, r_BH_W)[:, :2]
    omega = jnp.broadcast_to(mv(state.R_WB, state.omega_B), hips.shape)
    v_hip_C = mtv(to_C, state.v_WB[None] + cross(omega, r_BH_W))[:, :2]
    v_torso_C = mtv(R_WC, state.v_WB)[None, :2]
    v_des_C = jnp.stack([command.heading, command.lateral])[None] + command.turning * jnp.stack(
        [-r_BH_C[:, 1], r_BH_C[:, 0]], -1
    )
    v_ref_C = 0.5 * (v_hip_C + v_torso_C)
    balance = params.feedback[None] * jnp.sqrt(height / geometry.gravity)[:, None] * (v_ref_C - v_des_C)  # eq. 4
    ahead = params.feed_forward * v_des_C * stance_duration[:, None]
    offset = jnp.repeat(jnp.stack([params.heading_offset, params.lateral_offset], -1), 2, axis=0)
    offset = offset * jnp.stack([jnp.ones(4), jnp.asarray(LEFT_SIGN)], -1).astype(offset.dtype)
    reach = params.reach * (geometry.hip_length + geometry.thigh_length + geometry.shank_length)
    from_hip = jnp.clip(offset + ahead + balance, -reach, reach)
    # the hip goes on until the foot lands: a target fixed to the ground, not to the hip, is met at rest
    travel = from_hip + time_to_touch_down[:, None] * v_hip_C
    return start_W + (R_WC[None, :, :2] * travel[:, None, :]).sum(-1)


def _below(hips: Array, plane: Plane, height: Array) -> tuple[Array, Array]:
    """Points of the plane below the hips (4, 3): along gravity, and along the plane's normal."""
    up = jnp.array([[0.0, 0.0, 1.0]], hips.dtype)
    normal = plane.normal_W[None]
    return hips - height[:, None] * up, hips - (height * plane.normal_W[2])[:, None] * normal
