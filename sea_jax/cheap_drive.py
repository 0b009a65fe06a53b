"""The drive without its current loop: I = clip(I*, +-I_max, (+-V_bus - K_e w) / R).

The current loop is ten times faster than anything mechanical. The motor steps with the velocity loop instead:
five times fewer steps.
"""

import jax
import jax.numpy as jnp

from sea_jax.control_period import Tally, begin_period, finish_period, signals_at
from sea_jax.friction import coulomb_level
from sea_jax.hooks import apply_hooks
from sea_jax.motor import motor_step
from sea_jax.parameters import DriveParams, LoopPeriods
from sea_jax.types import DriveHooks, DriveOutput, DriveState, JointCommand, JointMeasurement, JointMotion
from sea_jax.velocity_loop import velocity_loop


def cheap_drive(
    params: DriveParams,
    state: DriveState,
    inputs: tuple[JointCommand, JointMeasurement, JointMotion],
    hooks: DriveHooks = DriveHooks(),  # noqa: B008
    periods: LoopPeriods = LoopPeriods(),  # noqa: B008
) -> tuple[DriveState, DriveOutput]:
    """One control period of drives whose current follows at once; all arrays (J,)."""
    period = periods.velocity
    start = begin_period(params, state, inputs, hooks, periods)
    coulomb = coulomb_level(params, start.motion.radial_load)

    def velocity_period(carry, time):
        state, tally = carry
        signals = signals_at(state, start.motion, time, period)
        bus, memory = apply_hooks(hooks, "supply_voltage", params.bus_voltage, signals, state.memory)
        wanted_current, integral = velocity_loop(
            params, start.commanded, state.motor_velocity, state.velocity_integral, period
        )
        back_emf = params.back_emf_constant * params.gear_ratio * state.motor_velocity
        conductance = 1.0 / params.resistance
        current = jnp.clip(wanted_current, (-bus - back_emf) * conductance, (bus - back_emf) * conductance)
        voltage = params.resistance * current + back_emf
        motor = motor_step(params, hooks, signals, current, coulomb, memory)
        state = DriveState(motor.position, motor.velocity, current, integral, params.resistance * current, motor.memory)
        return (state, tally.add(motor.spring_torque, current, voltage)), None

    times = jnp.arange(periods.velocity_steps, dtype=jnp.float32) * period
    (state, tally), _ = jax.lax.scan(velocity_period, (start.state, Tally.empty(state.current)), times)
    return finish_period(params, state, start, hooks, periods, period, tally)
