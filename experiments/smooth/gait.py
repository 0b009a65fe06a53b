"""The gaits' controller without events: every leg stands and swings by the contact schedule, in shares.

What `controller_jax.leg_coordination` decides from contact flags (early and late touch-down, slip, obstacles) has no
place here: a leg's share of support is that of the plan, rounded over a tick, and its last foothold follows the sole
by the share to which the foot presses on the ground. Everything else is the controller's own.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from controller_jax import gait, terrain_estimator
from controller_jax.foot_contact import soles
from controller_jax.foothold import desired_footholds
from controller_jax.force_distribution import DistributionState
from controller_jax.force_problem import support_legs
from controller_jax.gait import GaitPattern, LegPhases
from controller_jax.joint_torques import joint_torques
from controller_jax.leg_kinematics import leg_kinematics
from controller_jax.locomotion import GaitParams, LocomotionState
from controller_jax.rotations import control_frame, cross, mv
from controller_jax.swing_leg import joint_positions, swing_motion
from controller_jax.terrain_estimator import Plane
from controller_jax.torso_motion import TorsoTarget, torso_target
from controller_jax.types import JointTargets, LegGeometry, RobotState
from controller_jax.velocity_command import VelocityCommand, smoothed_command
from controller_jax.virtual_model import Integrals, virtual_model
from experiments.smooth.forces import smooth_forces, tangential
from experiments.smooth.laws import Widths, clip, step

Array = jax.Array
LEAST_LOAD = 1e-3  # of a leg in the air: keeps its share of the regularizer finite


class SmoothGaitState(NamedTuple):
    """What the scan carries."""

    phase: Array  # () of the stride
    command: VelocityCommand  # smoothed
    trim: VelocityCommand  # held: over one stride it hardly moves, and at its clamp it has no slope
    plane: Plane
    foothold_W: Array  # (4, 3) m
    integrals: Integrals
    distribution: DistributionState


class SmoothGaitInfo(NamedTuple):
    """What the cost looks at."""

    support: Array  # (4,) planned share
    plane: Plane
    torso: TorsoTarget
    tracking_C: Array  # (6,) wrench of the forces minus the desired one, N and N m
    cone_use: Array  # (4,)


def init(state: LocomotionState) -> SmoothGaitState:
    """As the controller itself begins."""
    return SmoothGaitState(
        state.phase, state.command, state.trim, state.plane, state.legs.foothold_W, state.integrals, state.distribution
    )


def control(
    widths: Widths,
    contact_force: float,
    params: GaitParams,
    geometry: LegGeometry,
    state: SmoothGaitState,
    robot: RobotState,
    command: VelocityCommand,
    time: Array,
    period: Array,
) -> tuple[SmoothGaitState, JointTargets, SmoothGaitInfo]:
    """One control period (s); robot.contact (4,) is the feet's force, N, and position_mode a share.

    contact_force: from which a foot counts as on the ground, N.
    """
    legs = leg_kinematics(geometry, robot.q)
    R_WB = robot.R_WB
    feet = soles(geometry, legs, robot.q, robot.qd, R_WB, state.plane.normal_W)
    soles_W = robot.r_WB[None] + mv(R_WB[None], feet.r_BS_B)

    pattern, phase = _schedule(params, state.phase, time, period)
    phases = gait.leg_phases(pattern, phase)
    planned = planned_support(widths, params, pattern, phase)
    pressed = step(robot.contact - contact_force, widths.contact_force)
    foothold_W = state.foothold_W + pressed[:, None] * (soles_W - state.foothold_W)
    plane = terrain_estimator.estimate(params.terrain, state.plane, foothold_W, period)
    R_WC = control_frame(R_WB, plane.normal_W)
    swing = (1.0 - gait.duty_factors(pattern)) * pattern.stride_duration
    stepping = step(swing.min() - params.start.shortest_swing, widths.time)
    wanted = VelocityCommand(*(stepping * speed for speed in command))
    smoothed = smoothed_command(params.velocity, state.command, wanted)
    asked = jax.tree.map(jnp.add, smoothed, state.trim)

    target = torso_target(params.torso, pattern, phases, phase, soles_W, plane, R_WC, asked, geometry.gravity)
    integrals, wrench = virtual_model(
        params.gains, params.integral_limits, geometry, state.integrals, robot, legs, target, R_WC, period
    )
    support = support_legs(geometry, legs, R_WB, R_WC, LEAST_LOAD + (1.0 - LEAST_LOAD) * planned, feet)
    distribution = smooth_forces(widths, params.distribution, state.distribution, support, wrench)
    force = planned[:, None] * distribution.force

    low, high = geometry.torque_limits[:, 0], geometry.torque_limits[:, 1]
    torque = clip(joint_torques(force, support.J_BF_C, support.weight_torque), low, high, widths.torque)
    position = _swing(params, geometry, robot, legs, foothold_W, pattern, phase, phases, R_WC, plane, asked)
    targets = JointTargets(torque, position, jnp.repeat(1.0 - planned, 3))
    got = jnp.concatenate([force.sum(0), cross(support.r_BF_C, force).sum(0)])
    cone_use = planned * tangential(distribution.force) / (params.distribution.friction * distribution.force[:, 2])
    info = SmoothGaitInfo(planned, plane, target, got - wrench, cone_use)
    return SmoothGaitState(phase, smoothed, state.trim, plane, foothold_W, integrals, distribution), targets, info


def _schedule(params: GaitParams, phase: Array, time: Array, period: Array) -> tuple[GaitPattern, Array]:
    """Contact schedule now, blended from standing into the gait, and the phase in it."""
    goal = gait.full_pattern(params.gait)
    going = jnp.clip((time - params.start.stand) / params.start.blend, 0.0, 1.0)
    pattern = gait.interpolate(gait.standing(goal), goal, going)
    return pattern, jnp.where(time >= params.start.stand, gait.advance(pattern, phase, period), phase)


def planned_support(widths: Widths, params: GaitParams, pattern: GaitPattern, phase: Array) -> Array:
    """Share (4,) to which each leg is planned to stand: rounded at its ends, whole where a swing would be too short."""
    duty = gait.duty_factors(pattern)
    from_middle = gait.wrap(phase - pattern.touch_down - 0.5 * duty + 0.5) - 0.5
    stands = step((0.5 * duty - jnp.abs(from_middle)) * pattern.stride_duration, widths.time)
    swing = (1.0 - duty) * pattern.stride_duration
    return 1.0 - (1.0 - stands) * step(swing - params.start.shortest_swing, widths.time)


def _swing(params, geometry, robot, legs, foothold_W, pattern, phase, phases: LegPhases, R_WC, plane, command) -> Array:
    """Joint positions (12,) along the swing; in the first half of a stance those of its end, where they still count."""
    duty = gait.duty_factors(pattern)
    since = gait.wrap(phase - pattern.touch_down)
    progress = jnp.where(since < 0.5 * duty, 1.0, phases.swing_phase)
    remaining = (1.0 - progress) * phases.swing_duration
    footholds = desired_footholds(
        params.foothold, geometry, robot, R_WC, plane, command, phases.stance_duration, remaining
    )
    motion = swing_motion(
        params.swing, foothold_W, footholds, progress, progress, phases.swing_duration, R_WC, plane, jnp.zeros(4)
    )
    return joint_positions(params.swing, geometry, robot, legs, motion, plane.normal_W)
