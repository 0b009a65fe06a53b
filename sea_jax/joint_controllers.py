"""Joint controllers: from wanted joint torque or position to wanted gear velocity, within speed and power.

Torque mode:   w = gain (tau_des - tau) + feed-forward * qd
Position mode: w = a (q_des - theta) + b (q_des - q) - c qd          (theta: gear angle; FACTS 2.1)
Limits:        |w| <= P_max / |tau|, then |w| <= w_max
"""

import jax.numpy as jnp

from sea_jax.parameters import DriveParams
from sea_jax.types import Array, JointCommand, JointMeasurement

# Below this torque the power limit allows more than any speed limit; keeps the division finite.
LEAST_TORQUE = 1e-3


def mode_velocities(params: DriveParams, command: JointCommand, measurement: JointMeasurement) -> tuple[Array, Array]:
    """Gear velocities that torque mode and position mode ask for before limits, (J,) rad/s each."""
    torque_mode = (
        params.torque_gain * (command.torque - measurement.torque) + params.velocity_feedforward * measurement.velocity
    )
    position_mode = (
        params.position_a * (command.position - measurement.motor_position)
        + params.position_b * (command.position - measurement.position)
        - params.position_c * measurement.velocity
    )
    return torque_mode, position_mode


def wanted_velocity(params: DriveParams, command: JointCommand, measurement: JointMeasurement) -> Array:
    """Gear velocity that the joint controllers ask for before limits, (J,) rad/s."""
    torque_mode, position_mode = mode_velocities(params, command, measurement)
    return jnp.where(command.position_mode > 0.5, position_mode, torque_mode)


def limited_velocity(params: DriveParams, velocity: Array, torque: Array) -> Array:
    """Gear velocity within power_limit / |measured torque| and the speed limit, (J,) rad/s."""
    powered = params.power_limit / jnp.maximum(jnp.abs(torque), LEAST_TORQUE)
    bound = jnp.minimum(powered, params.speed_limit)
    return jnp.clip(velocity, -bound, bound)
