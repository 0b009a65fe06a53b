"""Virtual model controller (eq. 5): the net force and torque that pull the torso along its desired motion."""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.leg_kinematics import LegKinematics, leg_mass
from controller_jax.rotations import cross, mm, mtv, mv, rotation_log
from controller_jax.torso_motion import TorsoTarget
from controller_jax.types import Array, LegGeometry, RobotState


class Gains(NamedTuple):
    """Diagonal gains along the axes of the control frame: heading, lateral, vertical; roll, pitch, yaw (FACTS 3.1)."""

    force_p: Array  # (3,) N/m
    force_i: Array  # (3,) N/(m s)
    force_d: Array  # (3,) N s/m
    torque_p: Array  # (3,) N m/rad
    torque_i: Array  # (3,) N m/(rad s)
    torque_d: Array  # (3,) N m s/rad
    mass: Array  # () that the desired acceleration is fed forward with, kg; eq. 5: the torso's
    inertia: Array  # (3,) that the desired angular acceleration is fed forward with, kg m^2; eq. 5: none


class IntegralLimits(NamedTuple):
    """Clamps of the integrators against windup."""

    force: Array  # () N
    torque: Array  # () N m


class Integrals(NamedTuple):
    """What the integrators add, control frame."""

    force: Array  # (3,) N
    torque: Array  # (3,) N m


def init_integrals() -> Integrals:
    return Integrals(jnp.zeros(3, jnp.float32), jnp.zeros(3, jnp.float32))


def virtual_model(
    gains: Gains,
    limits: IntegralLimits,
    geometry: LegGeometry,
    integrals: Integrals,
    state: RobotState,
    legs: LegKinematics,
    target: TorsoTarget,
    R_WC: Array,
    period: Array,
) -> tuple[Integrals, Array]:
    """Desired net wrench (6,) of the ground on the robot about the torso origin, control frame, N and N m.

    The integrators advance by one period (s); a period of zero holds them.
    """
    position_error = mtv(R_WC, target.r_WB - state.r_WB)
    velocity_error = mtv(R_WC, target.v_WB - state.v_WB)
    rotation_error = mtv(R_WC, rotation_log(mm(target.R_WB, state.R_WB.T)))
    rate_error = mtv(R_WC, target.omega_W - mv(state.R_WB, state.omega_B))
    integrals = Integrals(
        jnp.clip(integrals.force + period * gains.force_i * position_error, -limits.force, limits.force),
        jnp.clip(integrals.torque + period * gains.torque_i * rotation_error, -limits.torque, limits.torque),
    )
    weight, weight_moment = gravity_wrench(geometry, state, legs, R_WC)
    # eq. 5, both rows
    force = gains.force_p * position_error + integrals.force + gains.force_d * velocity_error
    force = force + gains.mass * mtv(R_WC, target.a_WB) - weight
    torque = gains.torque_p * rotation_error + integrals.torque + gains.torque_d * rate_error - weight_moment
    torque = torque + gains.inertia * mtv(R_WC, target.alpha_W)
    return integrals, jnp.concatenate([force, torque])


def gravity_wrench(geometry: LegGeometry, state: RobotState, legs: LegKinematics, R_WC: Array) -> tuple[Array, Array]:
    """Sum over all bodies of f_g (3,) and of r_Bk x f_g (3,) about the torso origin, control frame."""
    m_leg = leg_mass(geometry)
    r = legs.r_BG_B
    moment_B = m_leg * (r[0] + r[1] + r[2] + r[3]) + geometry.torso_mass * geometry.torso_com_B
    down_C = -geometry.gravity * R_WC[2]  # -g e_z of the world
    weight = (4.0 * m_leg + geometry.torso_mass) * down_C
    return weight, cross(mtv(R_WC, mv(state.R_WB, moment_B)), down_C)
