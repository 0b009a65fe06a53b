"""The squat jump's controller up to touch-down, without jumps in time: launch and flight are shares.

What the controller of `controller_jax.squat_jump` decides when the last foot leaves the ground, here happens in the
share by which that has happened: `flown` rises from 0 to 1 over the ticks in which the feet lose their load, and the
take-off's time, height and speed are means weighted by that rise. The crouch ends at a fixed time, which no parameter
moves.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from controller_jax.force_distribution import DistributionState, init_distribution
from controller_jax.force_problem import support_legs
from controller_jax.joint_torques import joint_torques
from controller_jax.leg_kinematics import inverse_kinematics, leg_kinematics
from controller_jax.periodic_splines import Curve
from controller_jax.rotations import control_frame, cross, mv
from controller_jax.splines import quintic_spline
from controller_jax.squat_jump import under_hips
from controller_jax.squat_jump_phases import OVERTIME, RISING
from controller_jax.squat_jump_settings import SquatJumpParams, SquatJumpSettings
from controller_jax.torso_motion import TorsoTarget
from controller_jax.types import JointTargets, RobotState
from controller_jax.virtual_model import Gains, Integrals, init_integrals, virtual_model
from experiments.smooth.forces import smooth_forces, tangential
from experiments.smooth.laws import Widths, any_of, clip, softplus, step

Array = jax.Array

LEAST_SHARE = 1e-3  # of a take-off that has hardly begun: keeps its weighted means finite
UP = (0.0, 0.0, 1.0)


class TakeOff(NamedTuple):
    """The event, as far as it has happened."""

    share: Array  # () 0: on the ground, 1: in the air
    time: Array  # () s, summed with the rise of the share as weight
    entry: Array  # (2,) height above ground, m, and its rate, m/s, in the same way

    def risen_to(self, share: Array, time: Array, entry: Array) -> "TakeOff":
        """After the share has risen at this time, at this height and rate."""
        rise = share - self.share
        return TakeOff(share, self.time + rise * time, self.entry + rise * entry)


class SmoothJumpState(NamedTuple):
    """What the scan carries."""

    take_off: TakeOff
    touched: Array  # () share to which the feet are back on the ground: from there on nothing counts
    integrals: Integrals
    distribution: DistributionState


class SmoothJumpInfo(NamedTuple):
    """What the cost looks at."""

    flown: Array  # () shares
    touched: Array
    tracking_error: Array  # (6,)
    cone_use: Array  # (4,)


def init() -> SmoothJumpState:
    zero = jnp.zeros(())
    return SmoothJumpState(TakeOff(zero, zero, jnp.zeros(2)), zero, init_integrals(), init_distribution())


def control(
    widths: Widths,
    contact_force: float,
    settings: SquatJumpSettings,
    params: SquatJumpParams,
    state: SmoothJumpState,
    robot: RobotState,
    time: Array,
) -> tuple[SmoothJumpState, JointTargets, SmoothJumpInfo]:
    """One control period; robot.contact (4,) is the feet's force, N, and position_mode a share.

    contact_force: from which a foot counts as on the ground, N.
    """
    geometry = settings.geometry
    legs = leg_kinematics(geometry, robot.q)
    feet_W = robot.r_WB[None] + mv(robot.R_WB[None], legs.r_BF_B)
    state = _advance(widths, contact_force, settings, state, robot, time)
    flown = state.take_off.share

    launching = (time >= settings.crouch_time).astype(jnp.float32)
    target = _torso_target(settings, params, robot, feet_W, launching, time)
    R_WC = control_frame(robot.R_WB, jnp.array(UP))
    learning = settings.control_period * (1.0 - launching)
    gains, limits = _gains(settings, params, launching), settings.integral_limits
    integrals, wrench = virtual_model(gains, limits, geometry, state.integrals, robot, legs, target, R_WC, learning)
    support = support_legs(geometry, legs, robot.R_WB, R_WC, jnp.ones(4))
    distribution = smooth_forces(widths, settings.distribution, state.distribution, support, wrench)
    force = distribution.force
    torque = joint_torques(force, support.J_BF_C, support.weight_torque)

    low, high = geometry.torque_limits[:, 0], geometry.torque_limits[:, 1]
    below = _foot_below_hip(settings, params, state.take_off, time)
    targets = JointTargets(
        torque=clip(torque, low, high, widths.torque),
        position=inverse_kinematics(geometry, under_hips(geometry, below)),
        position_mode=jnp.full(12, 1.0) * flown,
    )
    got = jnp.concatenate([force.sum(0), cross(support.r_BF_C, force).sum(0)])
    cone_use = (1.0 - flown) * tangential(force) / (settings.distribution.friction * force[:, 2])
    info = SmoothJumpInfo(flown, state.touched, (got - wrench) * (1.0 - flown), cone_use)
    return state._replace(integrals=integrals, distribution=distribution), targets, info


def _advance(
    widths: Widths,
    contact_force: float,
    settings: SquatJumpSettings,
    state: SmoothJumpState,
    robot: RobotState,
    time: Array,
) -> SmoothJumpState:
    """Shares of take-off and touch-down after this tick."""
    rate, flown = robot.v_WB[2], state.take_off.share
    late = settings.crouch_time + settings.launch_time + OVERTIME
    launching = ((time > settings.crouch_time) & (time <= late)).astype(jnp.float32)
    unloaded = jnp.prod(step(contact_force + widths.take_off - robot.contact, widths.take_off))
    leave = launching * unloaded * step(rate - RISING, widths.rate)
    entry = jnp.stack([robot.r_WB[2], rate])
    take_off = state.take_off.risen_to(flown + (1.0 - flown) * leave, time, entry)

    pressed = any_of(step(robot.contact - contact_force, widths.contact_force))
    touch = flown * pressed * step(-rate, widths.rate)
    return state._replace(take_off=take_off, touched=state.touched + (1.0 - state.touched) * touch)


def _torso_target(
    settings: SquatJumpSettings,
    params: SquatJumpParams,
    robot: RobotState,
    feet_W: Array,
    launching: Array,
    time: Array,
) -> TorsoTarget:
    """Level, over the middle of the feet, at the height of crouch or launch."""
    zero, up = jnp.zeros(()), jnp.array(UP)
    crouch = Curve(params.initial_height, zero, zero)
    launch = quintic_spline(params.height_knots, settings.launch_time, time - settings.crouch_time, "rest", "free")
    height = Curve(*(a + launching * (b - a) for a, b in zip(crouch, launch, strict=True)))
    ground = feet_W[:, 2].mean() - settings.geometry.foot_radius
    return TorsoTarget(
        r_WB=jnp.concatenate([feet_W[:, :2].mean(0), (ground + height.value)[None]]),
        v_WB=height.slope * up,
        a_WB=height.curvature * up,
        R_WB=control_frame(robot.R_WB, up),
        omega_W=jnp.zeros(3),
        alpha_W=jnp.zeros(3),
    )


def _gains(settings: SquatJumpSettings, params: SquatJumpParams, launching: Array) -> Gains:
    gains = settings.launch_gains
    own = gains.force_d[2]
    return gains._replace(force_d=gains.force_d.at[2].set(own + launching * (params.vertical_damping - own)))


def _foot_below_hip(settings: SquatJumpSettings, params: SquatJumpParams, take_off: TakeOff, time: Array) -> Array:
    """Foot below its hip, m: the spline spans the flight expected from the take-off's height and speed."""
    g, share = settings.geometry.gravity, take_off.share + LEAST_SHARE
    entry, start = take_off.entry / share, take_off.time / share
    rate = softplus(entry[1], 1e-2)
    fall = softplus(entry[0] - params.foot_knots[2] - settings.geometry.foot_radius, 1e-3)
    duration = (rate + jnp.sqrt(rate * rate + 2.0 * g * fall + 1e-6)) / g
    return quintic_spline(params.foot_knots, duration, softplus(time - start, 1e-3), "rest", "rest").value
