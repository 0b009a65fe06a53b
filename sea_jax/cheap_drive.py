"""The drive without its current loop: I = clip(I*, +-I_max, (+-V_bus - K_e w) / R).

The motor steps with the velocity loop: five times fewer steps.
"""

import jax
import jax.numpy as jnp

from sea_jax.control_period import Tally, begin_period, finish_period, signals_at
from sea_jax.electronics import back_emf
from sea_jax.friction import coulomb_level
from sea_jax.hooks import apply_hooks
from sea_jax.laws import LAWS, DriveLaws
from sea_jax.motor import motor_step
from sea_jax.parameters import DriveParams, LoopPeriods
from sea_jax.types import DriveHooks, DriveOutput, DriveState, JointCommand, JointMeasurement, JointMotion


def cheap_drive(
    params: DriveParams,
    state: DriveState,
    inputs: tuple[JointCommand, JointMeasurement, JointMotion],
    hooks: DriveHooks = DriveHooks(),  # noqa: B008
    periods: LoopPeriods = LoopPeriods(),  # noqa: B008
    laws: DriveLaws = LAWS,
) -> tuple[DriveState, DriveOutput]:
    """One control period of drives whose current follows at once; all arrays (J,)."""
    period = periods.velocity
    start = begin_period(params, state, inputs, hooks, periods, laws)
    coulomb = coulomb_level(params, start.motion.radial_load)

    def velocity_period(carry, time):
        state, tally = carry
        signals = signals_at(params, state, start.motion, time, period)
        bus, memory = apply_hooks(hooks, "supply_voltage", params.bus_voltage, signals, state.memory)
        wanted_current, integral = laws.velocity_loop(
            params, start.commanded, state.motor_velocity, state.velocity_integral, period
        )
        current = laws.current_at_once(params, wanted_current, state.motor_velocity, bus)
        voltage = params.resistance * current + back_emf(params, state.motor_velocity)
        motor = motor_step(params, hooks, signals, current, coulomb, memory, laws)
        held = params.resistance * current
        state = DriveState(motor.position, motor.velocity, current, integral, held, voltage, motor.memory)
        return (state, tally.add(motor.spring_torque, current, voltage)), None

    times = jnp.arange(periods.velocity_steps, dtype=jnp.float32) * period
    (state, tally), _ = jax.lax.scan(velocity_period, (start.state, Tally.empty(state.current)), times)
    return finish_period(params, state, start, hooks, periods, period, tally, laws)
