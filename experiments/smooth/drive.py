"""The drive without corners: limits, stick and slip, spring and stop rounded; the current follows at once.

As `sea_jax.cheap_drive`, with which it shares everything that is smooth already.
"""

from functools import partial

import jax
import jax.numpy as jnp

from experiments.smooth.laws import Widths, clip, softplus, step
from sea_jax import DriveHooks, DriveOutput, DriveParams, DriveState, Friction, LoopPeriods
from sea_jax.control_period import signals_at
from sea_jax.friction import coulomb_level, gear_friction
from sea_jax.hooks import apply_hooks
from sea_jax.joint_controllers import LEAST_TORQUE
from sea_jax.types import JointCommand, JointMeasurement

Array = jax.Array


def smooth_drive(widths: Widths):
    """A drive `step(params, state, (command, measurement, motion), hooks, periods)`; position_mode may be a share."""
    return partial(_step, widths)


def _step(
    widths: Widths,
    params: DriveParams,
    state: DriveState,
    inputs: tuple,
    hooks: DriveHooks = DriveHooks(),  # noqa: B008
    periods: LoopPeriods = LoopPeriods(),  # noqa: B008
) -> tuple[DriveState, DriveOutput]:
    command, measurement, motion = inputs
    signals = signals_at(state, motion, 0.0, periods.control)
    command, memory = apply_hooks(hooks, "command", command, signals, state.memory)
    measurement, memory = apply_hooks(hooks, "measurement", measurement, signals, memory)
    wanted = _wanted_velocity(params, command, measurement)
    bound = _speed_bound(widths, params, measurement.torque)
    commanded = clip(wanted, -bound, bound, widths.velocity)
    coulomb = coulomb_level(params, motion.radial_load)
    begin = state._replace(memory=memory)
    period = periods.velocity

    def velocity_period(carry, time):
        state, torque = carry
        signals = signals_at(state, motion, time, period)
        bus, memory = apply_hooks(hooks, "supply_voltage", params.bus_voltage, signals, state.memory)
        current, integral = _current(widths, params, commanded, state, bus, period)
        signals = signals._replace(current=current)
        spring, signals, memory = _spring(widths, params, hooks, signals, memory)
        motor, memory = apply_hooks(hooks, "motor_torque", params.torque_constant * current, signals, memory)
        friction = gear_friction(params, coulomb, state.motor_velocity)
        friction, memory = apply_hooks(hooks, "friction", friction, signals, memory)
        velocity = _motor_velocity(widths, params, state.motor_velocity, motor, spring, friction, period)
        position = state.motor_position + period * velocity
        state = DriveState(position, velocity, current, integral, params.resistance * current, memory)
        return (state, torque + spring), None

    times = jnp.arange(periods.velocity_steps, dtype=jnp.float32) * period
    (last, torque), _ = jax.lax.scan(velocity_period, (begin, jnp.zeros_like(state.current)), times)
    end_torque, signals, _ = _spring(
        widths, params, hooks, signals_at(last, motion, periods.control, period), last.memory
    )
    before = _coefficients(widths, params, begin.motor_position - motion.position)
    after = _coefficients(widths, params, signals.deflection)
    stiffness, damping = (0.5 * (first + last) for first, last in zip(before, after, strict=True))
    none = jnp.zeros_like(torque)
    return last, DriveOutput(
        torque=torque * (period / periods.control),
        damping=damping + stiffness * (0.5 * (periods.control - period)),
        end_torque=end_torque,
        wanted_velocity=wanted,
        commanded_velocity=commanded,
        peak_current=none,
        peak_voltage=none,
    )


def _wanted_velocity(params: DriveParams, command: JointCommand, measurement: JointMeasurement) -> Array:
    """Torque mode and position mode in the shares of the command."""
    torque_mode = (
        params.torque_gain * (command.torque - measurement.torque) + params.velocity_feedforward * measurement.velocity
    )
    position_mode = (
        params.position_a * (command.position - measurement.motor_position)
        + params.position_b * (command.position - measurement.position)
        - params.position_c * measurement.velocity
    )
    return torque_mode + command.position_mode * (position_mode - torque_mode)


def _speed_bound(widths: Widths, params: DriveParams, torque: Array) -> Array:
    """The smaller of speed limit and power limit / |torque|."""
    powered = params.power_limit / jnp.sqrt(torque * torque + LEAST_TORQUE**2)
    return params.speed_limit - softplus(params.speed_limit - powered, widths.velocity)


def _current(
    widths: Widths, params: DriveParams, wanted: Array, state: DriveState, bus: Array, period: float
) -> tuple[Array, Array]:
    """Current and integrator of the velocity loop, A, within current limit and bus voltage."""
    error = params.gear_ratio * (wanted - state.motor_velocity)
    limit = params.velocity_integral_limit
    integral = clip(state.velocity_integral + params.velocity_ki * period * error, -limit, limit, widths.current)
    limit = params.current_limit
    current = clip(params.velocity_kp * error + integral, -limit, limit, widths.current)
    back_emf = params.back_emf_constant * params.gear_ratio * state.motor_velocity
    low, high = (-bus - back_emf) / params.resistance, (bus - back_emf) / params.resistance
    return clip(current, low, high, widths.current), integral


def _coefficients(widths: Widths, params: DriveParams, deflection: Array) -> tuple[Array, Array]:
    """Stiffness and damping: the spring's on its own side, the stop's on the other, blended over a width."""
    one_sided = jnp.abs(params.spring_side)
    on_stop = one_sided * step(-params.spring_side * deflection, widths.deflection)
    return (
        params.spring_stiffness + on_stop * (params.stop_stiffness - params.spring_stiffness),
        params.spring_damping + on_stop * (params.stop_damping - params.spring_damping),
    )


def _spring(widths: Widths, params: DriveParams, hooks: DriveHooks, signals, memory):
    deflection = signals.motor_position - signals.joint_position
    rate = signals.motor_velocity - signals.joint_velocity
    signals = signals._replace(deflection=deflection, deflection_rate=rate)
    deflection, memory = apply_hooks(hooks, "deflection", deflection, signals, memory)
    signals = signals._replace(deflection=deflection)
    stiffness, damping = _coefficients(widths, params, deflection)
    torque, memory = apply_hooks(hooks, "spring", stiffness * deflection + damping * rate, signals, memory)
    return torque, signals._replace(spring_torque=torque), memory


def _motor_velocity(
    widths: Widths,
    params: DriveParams,
    velocity: Array,
    motor: Array,
    spring: Array,
    friction: Friction,
    period: float,
) -> Array:
    """Semi-implicit step; friction takes the free velocity away, up to its reach."""
    per_torque = period / (params.motor_inertia * params.gear_ratio)
    free = velocity + per_torque * (motor - friction.smooth - spring / params.gear_ratio)
    reach = per_torque * friction.coulomb
    return free - clip(free, -reach, reach, widths.stick)
