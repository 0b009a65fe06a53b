"""Squat jump (V.C.2): crouch, launch, flight, landing, standing; 13 numbers are searched, the rest is fixed.

Crouch and launch: the torso follows a height over the ground by virtual model and force distribution. Flight, from
when the last foot has left the ground: the feet follow a height under the hips by inverse kinematics. Landing, from
the first touch: each leg carries from its own first touch on, the torso is slowed down along one quintic to the
standing height and stays there. Heights of the torso count from the soles of the feet that stand.
"""

from typing import Final, NamedTuple

import jax.numpy as jnp

from controller_jax.force_distribution import (
    ITERATIONS,
    Iterations,
    distribute_forces,
    init_distribution,
)
from controller_jax.force_problem import SupportLegs, support_legs
from controller_jax.joint_torques import joint_torques, weight_torque
from controller_jax.leg_kinematics import inverse_kinematics, leg_kinematics
from controller_jax.periodic_splines import Curve, quintic
from controller_jax.rotations import control_frame, mv
from controller_jax.splines import quintic_spline
from controller_jax.squat_jump_phases import CROUCH, FLIGHT, LANDING, LAUNCH, SquatJumpState, advance, settled
from controller_jax.squat_jump_settings import SquatJumpParams, SquatJumpSettings
from controller_jax.torso_motion import TorsoTarget
from controller_jax.types import Array, JointTargets, LegGeometry, RobotState
from controller_jax.virtual_model import Gains, init_integrals, virtual_model

LEAST_ROOM: Final = 0.02  # m for the deceleration, however low the touch-down


class SquatJumpInfo(NamedTuple):
    """What cost and report look at."""

    phase: Array  # ()
    settled: Array  # () 1.0 where the torso's height is held: in the crouch, and when it stands again
    height: Array  # () torso above ground, m
    desired_height: Array  # () m
    support: Array  # (4,) 1.0 for a force-controlled leg
    desired_wrench: Array  # (6,) eq. 5, control frame, N and N m; zero in flight
    tracking_error: Array  # (6,) A lambda - b, zero in flight
    force: Array  # (4, 3) desired contact forces lambda, control frame, N
    cone_use: Array  # (4,) |tangential| / (mu normal) of lambda, 0 for legs in the air
    foot_below_hip: Array  # () planned in flight, m
    legs: SupportLegs  # with desired_wrench the input of the force distribution
    step_left: Array  # () residuals of the distribution
    pull_left: Array  # ()


def initial_pose(settings: SquatJumpSettings, params: SquatJumpParams) -> tuple[Array, Array]:
    """Joint positions (12,) of the crouch, feet under the hips, and the joint torques (12,) that carry it."""
    geometry = settings.geometry
    q = inverse_kinematics(geometry, under_hips(geometry, params.initial_height - geometry.foot_radius))
    legs = leg_kinematics(geometry, q)
    total = geometry.torso_mass + 4.0 * geometry.link_mass.sum()
    quarter = jnp.stack([jnp.zeros(()), jnp.zeros(()), 0.25 * total * geometry.gravity])
    force = jnp.broadcast_to(quarter, (4, 3))
    return q, joint_torques(force, legs.J_BF_B, weight_torque(geometry, legs, jnp.eye(3)))


def init(settings: SquatJumpSettings, params: SquatJumpParams) -> SquatJumpState:
    """Controller state at the start of the crouch."""
    zero = jnp.zeros(())
    entry = jnp.stack([params.initial_height, zero])
    return SquatJumpState(zero + CROUCH, zero, jnp.ones(4), zero, entry, init_integrals(), init_distribution())


def step(
    settings: SquatJumpSettings,
    params: SquatJumpParams,
    state: SquatJumpState,
    robot: RobotState,
    time: Array,
    iterations: Iterations = ITERATIONS,
) -> tuple[SquatJumpState, JointTargets, SquatJumpInfo]:
    """One control period at `time` (s) since the start of the crouch."""
    geometry = settings.geometry
    legs = leg_kinematics(geometry, robot.q)
    feet_W = robot.r_WB[None] + mv(robot.R_WB[None], legs.r_BF_B)
    state = advance(settings, state, robot, feet_W, time)
    elapsed = time - state.phase_start
    flying = (state.phase == FLIGHT).astype(jnp.float32)
    support = state.landed * (1.0 - flying)

    height = _desired_height(settings, params, state, elapsed)
    target = _torso_target(state, robot, feet_W, support, height)
    R_WC = control_frame(robot.R_WB, jnp.array([0.0, 0.0, 1.0]))
    gains = _gains(settings, params, state)
    still = settled(settings, state, elapsed)
    learning = settings.control_period * still
    integrals, wrench = virtual_model(
        gains, settings.integral_limits, geometry, state.integrals, robot, legs, target, R_WC, learning
    )
    standing = support_legs(geometry, legs, robot.R_WB, R_WC, support)
    distribution, forces = distribute_forces(settings.distribution, state.distribution, standing, wrench, iterations)
    torque = joint_torques(forces.force, standing.J_BF_C, standing.weight_torque)
    foot_below_hip = _foot_below_hip(settings, params, state, elapsed)
    targets = _targets(geometry, torque, foot_below_hip, support)

    grounded = 1.0 - flying
    normal = settings.distribution.friction * jnp.maximum(forces.force[:, 2], 1e-3)
    tangential = jnp.sqrt(forces.force[:, 0] ** 2 + forces.force[:, 1] ** 2 + 1e-12)
    info = SquatJumpInfo(
        phase=state.phase,
        settled=still,
        height=robot.r_WB[2] - state.ground,
        desired_height=height.value,
        support=support,
        desired_wrench=wrench * grounded,
        tracking_error=(forces.wrench - wrench) * grounded,
        force=forces.force,
        cone_use=support * tangential / normal,
        foot_below_hip=foot_below_hip,
        legs=standing,
        step_left=forces.step_left,
        pull_left=forces.pull_left,
    )
    return state._replace(integrals=integrals, distribution=distribution), targets, info


def _desired_height(
    settings: SquatJumpSettings, params: SquatJumpParams, state: SquatJumpState, elapsed: Array
) -> Curve:
    """Torso above ground with rate and acceleration, by phase."""
    launch = quintic_spline(params.height_knots, settings.launch_time, elapsed, "rest", "free")
    landing = _landing_height(settings, state.entry, elapsed)
    zero = jnp.zeros(())
    crouch = Curve(params.initial_height, zero, zero)

    def choose(crouch: Array, launch: Array, landing: Array) -> Array:
        return jnp.where(state.phase == CROUCH, crouch, jnp.where(state.phase == LAUNCH, launch, landing))

    return Curve(*(choose(*parts) for parts in zip(crouch, launch, landing, strict=True)))


def _landing_height(settings: SquatJumpSettings, entry: Array, elapsed: Array) -> Curve:
    """Even deceleration from touch-down (height, rate) to rest above the lowest height, then a quintic up."""
    height, rate = entry[0], jnp.minimum(entry[1], 0.0)
    room = jnp.maximum(height - settings.lowest_height, LEAST_ROOM)
    deceleration = jnp.maximum(settings.deceleration, 0.5 * rate * rate / room)
    stop = -rate / deceleration
    zero = jnp.zeros(())
    t = jnp.minimum(elapsed, stop)
    slowing = Curve(height + t * (rate + 0.5 * deceleration * t), rate + deceleration * t, deceleration)
    bottom = Curve(height + 0.5 * rate * stop, zero, zero)
    top = Curve(settings.landing_height, zero, zero)
    rising = quintic(bottom, top, settings.rise_time, jnp.clip(elapsed - stop, 0.0, settings.rise_time))
    return Curve(*(jnp.where(elapsed < stop, a, b) for a, b in zip(slowing, rising, strict=True)))


def _torso_target(
    state: SquatJumpState, robot: RobotState, feet_W: Array, support: Array, height: Curve
) -> TorsoTarget:
    """Level, over the middle of the standing feet, at a height over the ground; the heading is left as it is."""
    middle = (support[:, None] * feet_W[:, :2]).sum(0) / jnp.maximum(support.sum(), 1.0)
    up = jnp.array([0.0, 0.0, 1.0])
    return TorsoTarget(
        r_WB=jnp.concatenate([middle, (state.ground + height.value)[None]]),
        v_WB=height.slope * up,
        a_WB=height.curvature * up,
        R_WB=control_frame(robot.R_WB, up),
        omega_W=jnp.zeros(3),
        alpha_W=jnp.zeros(3),
    )


def _gains(settings: SquatJumpSettings, params: SquatJumpParams, state: SquatJumpState) -> Gains:
    """Landing gains from touch-down on; in the launch the searched vertical damping."""
    before, after = settings.launch_gains, settings.landing_gains
    vertical = jnp.where(state.phase == LAUNCH, params.vertical_damping, before.force_d[2])
    before = before._replace(force_d=jnp.stack([before.force_d[0], before.force_d[1], vertical]))
    return Gains(*(jnp.where(state.phase == LANDING, b, a) for a, b in zip(before, after, strict=True)))


def _targets(geometry: LegGeometry, torque: Array, foot_below_hip: Array, support: Array) -> JointTargets:
    """Torques for the legs that stand, within their limits; for the others feet under the hips."""
    limits = geometry.torque_limits
    return JointTargets(
        torque=jnp.clip(torque, limits[:, 0], limits[:, 1]),
        position=inverse_kinematics(geometry, under_hips(geometry, foot_below_hip)),
        position_mode=jnp.repeat(1.0 - support, 3),
    )


def _foot_below_hip(
    settings: SquatJumpSettings, params: SquatJumpParams, state: SquatJumpState, elapsed: Array
) -> Array:
    """Foot below its hip in flight: the spline spans the flight expected from take-off height and speed, m."""
    g = settings.geometry.gravity
    height, rate = state.entry[0], jnp.maximum(state.entry[1], 0.0)
    fall = jnp.maximum(height - params.foot_knots[2] - settings.geometry.foot_radius, 0.0)
    duration = (rate + jnp.sqrt(rate * rate + 2.0 * g * fall + 1e-6)) / g
    flight = quintic_spline(params.foot_knots, duration, elapsed, "rest", "rest").value
    return jnp.where(state.phase == FLIGHT, flight, params.foot_knots[2])


def under_hips(geometry: LegGeometry, below: Array) -> Array:
    """Feet (4, 3) straight under the hips, torso frame."""
    down = jnp.stack([jnp.zeros(()), jnp.zeros(()), -below])
    return geometry.r_BH_B + down[None]
