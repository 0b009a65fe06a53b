"""The drive without corners: the cheap drive under laws whose limits, stick and slip, spring and stop are rounded."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp

from experiments.smooth.laws import Widths, clip, softplus, step
from sea_jax import DriveParams, JointCommand, JointMeasurement, cheap_drive
from sea_jax.electronics import back_emf
from sea_jax.joint_controllers import LEAST_TORQUE, mode_velocities
from sea_jax.laws import DriveLaws

Array = jax.Array


def smooth_drive(widths: Widths) -> Callable:
    """A drive as `sea_jax.cheap_drive`; position_mode may be a share."""
    laws = DriveLaws(
        wanted_velocity,
        partial(limited_velocity, widths),
        partial(velocity_loop, widths),
        partial(current_at_once, widths),
        partial(spring_coefficients, widths),
        partial(stick_or_slip, widths),
    )
    return partial(cheap_drive, laws=laws)


def wanted_velocity(params: DriveParams, command: JointCommand, measurement: JointMeasurement) -> Array:
    """Torque mode and position mode in the shares of the command."""
    torque_mode, position_mode = mode_velocities(params, command, measurement)
    return torque_mode + command.position_mode * (position_mode - torque_mode)


def limited_velocity(widths: Widths, params: DriveParams, velocity: Array, torque: Array) -> Array:
    """Within the smaller of speed limit and power limit / |torque|."""
    powered = params.power_limit / jnp.sqrt(torque * torque + LEAST_TORQUE**2)
    bound = params.speed_limit - softplus(params.speed_limit - powered, widths.velocity)
    return clip(velocity, -bound, bound, widths.velocity)


def velocity_loop(
    widths: Widths, params: DriveParams, wanted: Array, velocity: Array, integral: Array, period: float
) -> tuple[Array, Array]:
    """Wanted current and integrator, A."""
    error = params.gear_ratio * (wanted - velocity)
    limit = params.velocity_integral_limit
    integral = clip(integral + params.velocity_ki * period * error, -limit, limit, widths.current)
    limit = params.current_limit
    return clip(params.velocity_kp * error + integral, -limit, limit, widths.current), integral


def current_at_once(widths: Widths, params: DriveParams, wanted: Array, velocity: Array, bus_voltage: Array) -> Array:
    """The wanted current within what the bus can drive, A."""
    induced = back_emf(params, velocity)
    low, high = (-bus_voltage - induced) / params.resistance, (bus_voltage - induced) / params.resistance
    return clip(wanted, low, high, widths.current)


def spring_coefficients(widths: Widths, params: DriveParams, deflection: Array) -> tuple[Array, Array]:
    """Stiffness and damping: the spring's on its own side, the stop's on the other, blended over a width."""
    one_sided = jnp.abs(params.spring_side)
    on_stop = one_sided * step(-params.spring_side * deflection, widths.deflection)
    return (
        params.spring_stiffness + on_stop * (params.stop_stiffness - params.spring_stiffness),
        params.spring_damping + on_stop * (params.stop_damping - params.spring_damping),
    )


def stick_or_slip(widths: Widths, free_velocity: Array, reach: Array) -> Array:
    """Friction takes the free velocity away, up to its reach."""
    return free_velocity - clip(free_velocity, -reach, reach, widths.stick)
