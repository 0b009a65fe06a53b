"""The robot's sensors: IMU at the torso's origin and joint encoders. Ideal first, then bias and noise with a key.

The IMU reports means over the period between two states, as a chip does that integrates: the increment of velocity
and the rotation, over the period.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from mjx_starleth.block_solve import apply, total, transpose
from mjx_starleth.body_types import BodyState
from mjx_starleth.rotation import quaternion_product, rotation_matrix

Array = jax.Array


class Imu(NamedTuple):
    """One reading; torso frame."""

    specific_force: Array  # (3,) acceleration minus gravity, m/s^2
    angular_velocity: Array  # (3,) rad/s


class Encoders(NamedTuple):
    """One reading of the joints."""

    position: Array  # (12,) rad
    velocity: Array  # (12,) rad/s


class SensorErrors(NamedTuple):
    """Bias and standard deviation of one reading's noise; zeros are ideal sensors."""

    specific_force_bias: Array  # (3,) m/s^2
    specific_force_noise: Array  # () m/s^2
    angular_velocity_bias: Array  # (3,) rad/s
    angular_velocity_noise: Array  # () rad/s
    position_bias: Array  # (12,) rad
    position_noise: Array  # () rad
    velocity_noise: Array  # () rad/s


def no_errors() -> SensorErrors:
    zero = jnp.zeros((), jnp.float32)
    three, twelve = jnp.zeros(3, jnp.float32), jnp.zeros(12, jnp.float32)
    return SensorErrors(three, zero, three, zero, twelve, zero, zero)


def imu(before: BodyState, after: BodyState, gravity: Array, period: float) -> Imu:
    """Ideal reading over the period between two states; gravity (3,) in the world, m/s^2.

    The specific force is turned by the orientation at mid-period, which keeps it second-order accurate.
    """
    turn = quaternion_product(before.q[3:7] * jnp.array([1, -1, -1, -1], jnp.float32), after.q[3:7])
    turn = jnp.where(turn[0] < 0, -turn, turn)
    sine = jnp.sqrt(total(turn[1:] * turn[1:]) + 1e-20)
    angle = 2 * jnp.arctan2(sine, turn[0])

    middle = before.q[3:7] + jnp.where(total(before.q[3:7] * after.q[3:7]) < 0, -after.q[3:7], after.q[3:7])
    middle = middle * jax.lax.rsqrt(total(middle * middle))
    acceleration_W = (after.u[:3] - before.u[:3]) / period - gravity
    return Imu(apply(transpose(rotation_matrix(middle)), acceleration_W), turn[1:] * (angle / (sine * period)))


def encoders(state: BodyState) -> Encoders:
    """Ideal reading."""
    return Encoders(state.q[7:], state.u[6:])


def disturb_imu(reading: Imu, errors: SensorErrors, key: Array) -> Imu:
    """The reading with bias and white noise drawn with `key`."""
    force_key, rate_key = jax.random.split(key)
    force = errors.specific_force_bias + errors.specific_force_noise * jax.random.normal(force_key, (3,), jnp.float32)
    rate = errors.angular_velocity_bias + errors.angular_velocity_noise * jax.random.normal(rate_key, (3,), jnp.float32)
    return Imu(reading.specific_force + force, reading.angular_velocity + rate)


def disturb_encoders(reading: Encoders, errors: SensorErrors, key: Array) -> Encoders:
    """The reading with bias and white noise drawn with `key`."""
    position_key, velocity_key = jax.random.split(key)
    position = errors.position_bias + errors.position_noise * jax.random.normal(position_key, (12,), jnp.float32)
    velocity = errors.velocity_noise * jax.random.normal(velocity_key, (12,), jnp.float32)
    return Encoders(reading.position + position, reading.velocity + velocity)
