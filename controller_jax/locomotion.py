"""Dynamic gaits: the blocks of Fig. 2 composed into one control period."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from controller_jax import gait, leg_coordination, terrain_estimator
from controller_jax.foot_contact import Soles, soles
from controller_jax.foothold import FootholdParams, desired_footholds
from controller_jax.force_distribution import (
    DistributionSettings,
    DistributionState,
    distribute_forces,
    init_distribution,
)
from controller_jax.force_problem import support_legs
from controller_jax.gait import ReducedGait
from controller_jax.joint_torques import joint_torques
from controller_jax.leg_coordination import CoordinationParams, LegEvents, LegMemory
from controller_jax.leg_kinematics import LegKinematics, leg_kinematics
from controller_jax.rotations import control_frame, cross, mtv, mv
from controller_jax.swing_leg import FootMotion, SwingParams, joint_positions, swing_motion
from controller_jax.terrain_estimator import Plane, TerrainParams
from controller_jax.torso_motion import TorsoParams, TorsoTarget, torso_target
from controller_jax.types import Array, JointTargets, LegGeometry, RobotState
from controller_jax.velocity_command import VelocityCommand, VelocityParams, integrated_trim, smoothed_command
from controller_jax.virtual_model import Gains, IntegralLimits, Integrals, init_integrals, virtual_model


class StartParams(NamedTuple):
    """How the gait begins: all legs stand, then the duty factors shrink to those of the gait."""

    stand: Array  # () s
    blend: Array  # () s, > 0
    shortest_swing: Array  # () s, a leg with less time than this for a step keeps standing


class GaitParams(NamedTuple):
    """Every number of the controller; any of them may be searched."""

    gait: ReducedGait
    start: StartParams
    velocity: VelocityParams
    terrain: TerrainParams
    coordination: CoordinationParams
    torso: TorsoParams
    gains: Gains
    integral_limits: IntegralLimits
    distribution: DistributionSettings
    foothold: FootholdParams
    swing: SwingParams


class LocomotionState(NamedTuple):
    """What the scan carries."""

    phase: Array  # () of the stride
    command: VelocityCommand  # smoothed
    trim: VelocityCommand  # added to it, for the mean velocity to meet it
    plane: Plane
    legs: LegMemory
    integrals: Integrals
    distribution: DistributionState


class LocomotionInfo(NamedTuple):
    """What the controller planned and saw in one control period."""

    phase: Array  # ()
    planned_stance: Array  # (4,)
    support: Array  # (4,) force-controlled legs
    events: LegEvents
    command: VelocityCommand
    plane: Plane
    torso: TorsoTarget
    wrench_C: Array  # (6,) desired on the torso, control frame, N and N m
    force_C: Array  # (4, 3) desired ground on foot, N
    tracking_C: Array  # (6,) wrench of those forces minus the desired one
    foot: FootMotion  # desired motion of the soles of swing legs


def init(geometry: LegGeometry, robot: RobotState) -> LocomotionState:
    """The robot stands on all legs; the ground is the plane under its feet."""
    zero = jnp.zeros((), jnp.float32)
    up = jnp.array([0.0, 0.0, 1.0], jnp.float32)
    legs = leg_kinematics(geometry, robot.q)
    feet = soles(geometry, legs, robot.q, robot.qd, robot.R_WB, up)
    soles_W = robot.r_WB[None] + mv(robot.R_WB[None], feet.r_BS_B)
    return LocomotionState(
        phase=zero,
        command=VelocityCommand(zero, zero, zero),
        trim=VelocityCommand(zero, zero, zero),
        plane=terrain_estimator.fit_plane(soles_W),
        legs=leg_coordination.standing(soles_W),
        integrals=init_integrals(),
        distribution=init_distribution(),
    )


def step(
    params: GaitParams,
    geometry: LegGeometry,
    state: LocomotionState,
    robot: RobotState,
    command: VelocityCommand,
    time: Array,
    period: Array,
) -> tuple[LocomotionState, JointTargets, LocomotionInfo]:
    """One control period (s): what the joints should do, given the robot, the operator's command and the time."""
    legs, feet, soles_W, slip_velocity_W = _sense(geometry, robot, state.plane)
    pattern, phase, stepping = _schedule(params, state.phase, time, period)
    phases = gait.leg_phases(pattern, phase)
    memory, roles, events = leg_coordination.coordinate(
        params.coordination, state.legs, phases, robot.contact, soles_W, slip_velocity_W, state.plane.normal_W, period
    )
    plane = terrain_estimator.estimate(params.terrain, state.plane, memory.foothold_W, period)
    # without the barrier XLA fits the plane again for each of its many uses: 8 % of the whole loop
    plane, R_WC = jax.lax.optimization_barrier((plane, control_frame(robot.R_WB, plane.normal_W)))
    smoothed, trim = _wanted_velocity(params, state, robot, R_WC, command, stepping, period)
    asked = jax.tree.map(jnp.add, smoothed, trim)

    target = torso_target(params.torso, pattern, phases, phase, soles_W, plane, R_WC, asked, geometry.gravity)
    integrals, wrench_C = virtual_model(
        params.gains, params.integral_limits, geometry, state.integrals, robot, legs, target, R_WC, period
    )
    support = support_legs(geometry, legs, robot.R_WB, R_WC, roles.support, feet)
    distribution, forces = distribute_forces(params.distribution, state.distribution, support, wrench_C)

    motion = _swing(params, geometry, robot, memory, roles, phases, R_WC, plane, asked, soles_W)
    position = joint_positions(params.swing, geometry, robot, legs, motion, plane.normal_W)
    torque = joint_torques(forces.force, support.J_BF_C, support.weight_torque)
    targets = JointTargets(torque, position, jnp.repeat(1.0 - roles.support, 3))
    info = LocomotionInfo(
        phase=phase,
        planned_stance=phases.stance,
        support=roles.support,
        events=events,
        command=smoothed,
        plane=plane,
        torso=target,
        wrench_C=wrench_C,
        force_C=forces.force,
        tracking_C=forces.wrench - wrench_C,
        foot=motion,
    )
    return LocomotionState(phase, smoothed, trim, plane, memory, integrals, distribution), targets, info


def _sense(geometry: LegGeometry, robot: RobotState, plane: Plane) -> tuple[LegKinematics, Soles, Array, Array]:
    """The legs, their soles seen from the torso, and in the world: places (4, 3) m and velocities (4, 3) m/s."""
    legs = leg_kinematics(geometry, robot.q)
    feet = soles(geometry, legs, robot.q, robot.qd, robot.R_WB, plane.normal_W)
    soles_W = robot.r_WB[None] + mv(robot.R_WB[None], feet.r_BS_B)
    omega = jnp.broadcast_to(robot.omega_B, (4, 3))
    slip_velocity_W = robot.v_WB[None] + mv(robot.R_WB[None], cross(omega, feet.r_BS_B) + feet.v_BS_B)
    return legs, feet, soles_W, slip_velocity_W


def _wanted_velocity(params, state, robot, R_WC, command, stepping, period) -> tuple[VelocityCommand, VelocityCommand]:
    """The smoothed command, and what is added to it for the mean velocity to meet it."""
    # a torso that leaves before its feet do overstretches the legs behind it
    wanted = VelocityCommand(*(stepping * speed for speed in command))
    smoothed = smoothed_command(params.velocity, state.command, wanted)
    return smoothed, integrated_trim(params.velocity, state.trim, smoothed, torso_velocity(robot, R_WC), period)


def torso_velocity(robot: RobotState, R_WC: Array) -> VelocityCommand:
    """What the torso does of what can be commanded."""
    v_C, omega_C = mtv(R_WC, robot.v_WB), mtv(R_WC, mv(robot.R_WB, robot.omega_B))
    return VelocityCommand(v_C[0], v_C[1], omega_C[2])


def _schedule(params, phase, time, period):
    """Contact schedule now, the phase in it, and whether legs step: standing at rest, then blended into the gait."""
    goal = gait.full_pattern(params.gait)
    going = jnp.clip((time - params.start.stand) / params.start.blend, 0.0, 1.0)
    pattern = gait.interpolate(gait.standing(goal), goal, going)
    swing = (1.0 - gait.duty_factors(pattern)) * pattern.stride_duration
    stays = swing < params.start.shortest_swing
    pattern = pattern._replace(lift_off=jnp.where(stays, gait.standing(pattern).lift_off, pattern.lift_off))
    phase = jnp.where(time >= params.start.stand, gait.advance(pattern, phase, period), phase)
    return pattern, phase, 1.0 - stays.any().astype(phase.dtype)


def _swing(params, geometry, robot, memory, roles, phases, R_WC, plane, command, soles_W) -> FootMotion:
    """Desired motion of the soles: along the swing to the foothold, or the reflex."""
    remaining = (1.0 - phases.swing_phase) * phases.swing_duration
    footholds = desired_footholds(
        params.foothold, geometry, robot, R_WC, plane, command, phases.stance_duration, remaining
    )
    motion = swing_motion(
        params.swing,
        memory.foothold_W,
        footholds,
        phases.swing_phase,
        roles.swing_progress,
        phases.swing_duration,
        R_WC,
        plane,
        roles.clearance,
    )
    normal = plane.normal_W[None]
    lowering = FootMotion(memory.sought_W, -params.coordination.lowering_speed * normal)
    raising = FootMotion(soles_W + roles.raising[:, None] * normal, jnp.zeros_like(normal))
    seek, hit = (roles.seek > 0.0)[:, None], (roles.raising > 0.0)[:, None]
    return FootMotion(
        *(
            jnp.where(seek, low, jnp.where(hit, high, swing))
            for low, high, swing in zip(lowering, raising, motion, strict=True)
        )
    )
