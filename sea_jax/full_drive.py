"""The whole chain of paper section IV over one control period: nested loops, motor and spring."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from sea_jax.control_period import Tally, begin_period, finish_period, signals_at
from sea_jax.current_loop import current_loop
from sea_jax.electronics import electronics, winding
from sea_jax.friction import coulomb_level
from sea_jax.hooks import apply_hooks
from sea_jax.motor import motor_step
from sea_jax.parameters import DriveParams, LoopPeriods
from sea_jax.types import DriveHooks, DriveOutput, DriveState, JointCommand, JointMeasurement, JointMotion
from sea_jax.velocity_loop import velocity_loop


def full_drive(
    params: DriveParams,
    state: DriveState,
    inputs: tuple[JointCommand, JointMeasurement, JointMotion],
    hooks: DriveHooks = DriveHooks(),  # noqa: B008
    periods: LoopPeriods = LoopPeriods(),  # noqa: B008
) -> tuple[DriveState, DriveOutput]:
    """One control period of drives with current loop and electronics; all arrays (J,)."""
    return watched_drive(params, state, inputs, hooks, periods, None, lambda seen, state, time: seen)[:2]


def watched_drive(
    params: DriveParams,
    state: DriveState,
    inputs: tuple[JointCommand, JointMeasurement, JointMotion],
    hooks: DriveHooks,
    periods: LoopPeriods,
    seen: Any,
    watch: Callable[[Any, DriveState, Any], Any],
) -> tuple[DriveState, DriveOutput, Any]:
    """The same, and `seen` after `watch(seen, state, time)` of each step of the current loop; time [s] at its end."""
    period = periods.current
    start = begin_period(params, state, inputs, hooks, periods)
    coil = winding(params, period)
    coulomb = coulomb_level(params, start.motion.radial_load)

    def current_period(carry, time):
        state, tally, seen, wanted_current = carry
        signals = signals_at(params, state, start.motion, time, period)
        bus, memory = apply_hooks(hooks, "supply_voltage", params.bus_voltage, signals, state.memory)
        voltage, integral = current_loop(params, wanted_current, state.current, state.current_integral, bus, period)
        current = electronics(coil, voltage, state.motor_velocity, state.current)
        motor = motor_step(params, hooks, signals, current, coulomb, memory)
        held = state.velocity_integral
        state = DriveState(motor.position, motor.velocity, current, held, integral, voltage, motor.memory)
        seen = watch(seen, state, time + period)
        return (state, tally.add(motor.spring_torque, current, voltage), seen, wanted_current), None

    def velocity_period(carry, time):
        state, tally, seen = carry
        wanted_current, integral = velocity_loop(
            params, start.commanded, state.motor_velocity, state.velocity_integral, periods.velocity
        )
        state = state._replace(velocity_integral=integral)
        times = time + jnp.arange(periods.current_steps, dtype=jnp.float32) * period
        (state, tally, seen, _), _ = jax.lax.scan(current_period, (state, tally, seen, wanted_current), times)
        return (state, tally, seen), None

    times = jnp.arange(periods.velocity_steps, dtype=jnp.float32) * periods.velocity
    begun = (start.state, Tally.empty(state.current), seen)
    (state, tally, seen), _ = jax.lax.scan(velocity_period, begun, times)
    return *finish_period(params, state, start, hooks, periods, period, tally), seen
