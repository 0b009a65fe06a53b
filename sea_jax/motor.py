"""Motor mechanics (paper IV.4): Theta dw/dt = K I - tau_f - tau / N, by a semi-implicit Euler step.

Velocity takes the torques at the start of the step and friction implicitly, position takes the new velocity. The
link gets the same spring torque over the same step, so that action and reaction balance.
"""

from typing import NamedTuple

import jax.numpy as jnp

from sea_jax.friction import gear_friction
from sea_jax.hooks import apply_hooks
from sea_jax.laws import LAWS, DriveLaws
from sea_jax.parameters import DriveParams
from sea_jax.spring import spring_torque
from sea_jax.types import Array, DriveHooks, Signals


class MotorStep(NamedTuple):
    """What one step leaves, (J,)."""

    position: Array  # gear output, rad
    velocity: Array  # gear output, rad/s
    spring_torque: Array  # on the link during the step, N m
    memory: dict


def spring_on_link(
    params: DriveParams, hooks: DriveHooks, signals: Signals, memory: dict, laws: DriveLaws = LAWS
) -> tuple[Array, Signals, dict]:
    """Spring torque through the hooks of deflection and spring; signals come back with what was found."""
    deflection = signals.motor_position - signals.joint_position
    rate = signals.motor_velocity - signals.joint_velocity
    signals = signals._replace(deflection=deflection, deflection_rate=rate)
    deflection, memory = apply_hooks(hooks, "deflection", deflection, signals, memory)
    signals = signals._replace(deflection=deflection)
    torque = spring_torque(params, deflection, rate, laws.spring_coefficients)
    torque, memory = apply_hooks(hooks, "spring", torque, signals, memory)
    return torque, signals._replace(spring_torque=torque), memory


def motor_step(
    params: DriveParams,
    hooks: DriveHooks,
    signals: Signals,
    current: Array,
    coulomb: Array,
    memory: dict,
    laws: DriveLaws = LAWS,
) -> MotorStep:
    """One step of signals.period; signals hold motor and link at its start, `current` (A) acts during it."""
    spring, signals, memory = spring_on_link(params, hooks, signals._replace(current=current), memory, laws)
    motor, memory = apply_hooks(hooks, "motor_torque", params.torque_constant * current, signals, memory)
    friction = gear_friction(params, coulomb, signals.motor_velocity)
    friction, memory = apply_hooks(hooks, "friction", friction, signals, memory)

    per_torque = signals.period / (params.motor_inertia * params.gear_ratio)
    drive = motor - friction.smooth - spring / params.gear_ratio
    # a hook may take more from the level than there is, and friction must not push
    level = jnp.maximum(friction.coulomb, 0.0)
    velocity = laws.stick_or_slip(signals.motor_velocity + per_torque * drive, per_torque * level)
    position = signals.motor_position + signals.period * velocity
    return MotorStep(position, velocity, spring, memory)
