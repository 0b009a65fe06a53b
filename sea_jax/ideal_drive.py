"""The drive that does as told: a perfect torque source, and a joint PD as position source (FACTS 2.1).

In position mode the PD acts on the measured values, carried on by the true motion within the period.
"""

import jax.numpy as jnp

from sea_jax.hooks import apply_hooks, link_signals
from sea_jax.parameters import DriveParams, LoopPeriods
from sea_jax.types import (
    DriveHooks,
    DriveOutput,
    DriveState,
    JointCommand,
    JointMeasurement,
    JointMotion,
)


def ideal_drive(
    params: DriveParams,
    state: DriveState,
    inputs: tuple[JointCommand, JointMeasurement, JointMotion],
    hooks: DriveHooks = DriveHooks(),  # noqa: B008
    periods: LoopPeriods = LoopPeriods(),  # noqa: B008
) -> tuple[DriveState, DriveOutput]:
    """One control period of drives without actuator; only hooks of command and measurement act. All (J,)."""
    command, measurement, motion = inputs
    signals = link_signals(motion, periods.control)
    command, memory = apply_hooks(hooks, "command", command, signals, state.memory)
    measurement, memory = apply_hooks(hooks, "measurement", measurement, signals, memory)

    time, stiffness, damping = periods.control, params.ideal_stiffness, params.ideal_damping
    mean_turn = time * (0.5 * motion.velocity + time / 6.0 * motion.acceleration)
    mean_velocity = measurement.velocity + 0.5 * time * motion.acceleration
    holding = stiffness * (command.position - measurement.position - mean_turn) - damping * mean_velocity

    position_mode = command.position_mode > 0.5
    asked = jnp.where(position_mode, holding, command.torque)
    # the end stop of a one-sided spring lets the motor pull the other way, which only position control makes use of
    most = jnp.maximum(-params.torque_min, params.torque_max)
    lower = jnp.where(position_mode, -most, params.torque_min)
    upper = jnp.where(position_mode, most, params.torque_max)
    torque = jnp.clip(asked, lower, upper)
    free = position_mode & (asked == torque)
    turn = time * (motion.velocity + 0.5 * time * motion.acceleration)
    velocity = motion.velocity + time * motion.acceleration
    zero = jnp.zeros_like(torque)
    return DriveState(motion.position + turn, velocity, zero, zero, zero, zero, memory), DriveOutput(
        torque=torque,
        damping=jnp.where(free, damping + 0.5 * time * stiffness, 0.0),
        end_torque=torque,
        wanted_velocity=velocity,
        commanded_velocity=velocity,
        peak_current=zero,
        peak_voltage=zero,
    )
