"""The whole chain of paper section IV over one control period: nested loops, motor and spring."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from sea_jax.control_period import Link, begin_period, finish_period, link_at
from sea_jax.current_loop import current_loop
from sea_jax.electronics import electronics, winding
from sea_jax.friction import coulomb_level
from sea_jax.hooks import apply_hooks, no_signals
from sea_jax.motor import motor_step
from sea_jax.parameters import DriveParams, LoopPeriods
from sea_jax.types import (
    Array,
    DriveHooks,
    DriveOutput,
    DriveState,
    JointCommand,
    JointMeasurement,
    JointMotion,
)
from sea_jax.velocity_loop import velocity_loop


class Tally(NamedTuple):
    """What is summed or kept over the period."""

    torque: Array
    damping: Array
    peak_current: Array
    peak_voltage: Array


def full_drive(
    params: DriveParams,
    state: DriveState,
    inputs: tuple[JointCommand, JointMeasurement, JointMotion],
    hooks: DriveHooks = DriveHooks(),  # noqa: B008
    periods: LoopPeriods = LoopPeriods(),  # noqa: B008
) -> tuple[DriveState, DriveOutput]:
    """One control period of drives with current loop and electronics; all arrays (J,)."""
    period = periods.current
    start = begin_period(params, state, inputs, hooks, periods)
    coil = winding(params, period)
    coulomb = coulomb_level(params, start.motion.radial_load)
    idle = no_signals(state.current, period)

    def current_period(carry, time):
        state, tally, wanted_current = carry
        link: Link = link_at(start.motion, time)
        signals = idle._replace(
            motor_position=state.motor_position,
            motor_velocity=state.motor_velocity,
            current=state.current,
            joint_position=link.position,
            joint_velocity=link.velocity,
        )
        bus, memory = apply_hooks(hooks, "supply_voltage", params.bus_voltage, signals, state.memory)
        voltage, integral = current_loop(params, wanted_current, state.current, state.current_integral, bus, period)
        current = electronics(coil, voltage, state.motor_velocity, state.current)
        motor = motor_step(params, hooks, signals, current, coulomb, memory)
        state = DriveState(motor.position, motor.velocity, current, state.velocity_integral, integral, motor.memory)
        tally = Tally(
            tally.torque + motor.spring_torque,
            tally.damping + motor.damping + motor.stiffness * time,
            jnp.maximum(tally.peak_current, jnp.abs(current)),
            jnp.maximum(tally.peak_voltage, jnp.abs(voltage)),
        )
        return (state, tally, wanted_current), None

    def velocity_period(carry, time):
        state, tally = carry
        wanted_current, integral = velocity_loop(
            params, start.commanded, state.motor_velocity, state.velocity_integral, periods.velocity
        )
        state = state._replace(velocity_integral=integral)
        times = time + jnp.arange(periods.current_steps, dtype=jnp.float32) * period
        (state, tally, _), _ = jax.lax.scan(current_period, (state, tally, wanted_current), times)
        return (state, tally), None

    zero = jnp.zeros_like(state.current)
    times = jnp.arange(periods.velocity_steps, dtype=jnp.float32) * periods.velocity
    (state, tally), _ = jax.lax.scan(velocity_period, (start.state, Tally(zero, zero, zero, zero)), times)
    count = periods.velocity_steps * periods.current_steps
    return finish_period(params, state, start, hooks, periods, period, tally, count)
