"""What all drives with a spring share over a control period: its start, the link's motion, its sums, its end."""

from typing import NamedTuple

import jax.numpy as jnp

from sea_jax.hooks import apply_hooks, no_signals
from sea_jax.laws import LAWS, DriveLaws
from sea_jax.motor import spring_on_link
from sea_jax.parameters import DriveParams, LoopPeriods
from sea_jax.types import (
    Array,
    DriveHooks,
    DriveOutput,
    DriveState,
    JointCommand,
    JointMeasurement,
    JointMotion,
    Signals,
)


class PeriodStart(NamedTuple):
    """A control period about to run, (J,)."""

    state: DriveState
    motion: JointMotion
    wanted: Array  # gear velocity before limits, rad/s
    commanded: Array  # after limits, rad/s


class Tally(NamedTuple):
    """What is gathered over the steps of a period, (J,)."""

    torque: Array  # sum of the spring's torque on the link, N m
    peak_current: Array  # A
    peak_voltage: Array  # V

    @classmethod
    def empty(cls, like: Array) -> "Tally":
        return cls(*(jnp.zeros_like(like),) * 3)

    def add(self, torque: Array, current: Array, voltage: Array) -> "Tally":
        return Tally(
            self.torque + torque,
            jnp.maximum(self.peak_current, jnp.abs(current)),
            jnp.maximum(self.peak_voltage, jnp.abs(voltage)),
        )


def signals_at(
    params: DriveParams, state: DriveState, motion: JointMotion, time: Array | float, period: float
) -> Signals:
    """Motor as in `state`, link extrapolated `time` seconds into the period with constant acceleration."""
    turned = motion.acceleration * time
    return no_signals(state.current, period)._replace(
        motor_position=state.motor_position,
        motor_velocity=state.motor_velocity,
        current=state.current,
        winding_voltage=state.voltage,
        joint_position=motion.position + time * (motion.velocity + 0.5 * turned),
        joint_velocity=motion.velocity + turned,
        radial_load=motion.radial_load,
    )


def begin_period(
    params: DriveParams,
    state: DriveState,
    inputs: tuple[JointCommand, JointMeasurement, JointMotion],
    hooks: DriveHooks,
    periods: LoopPeriods,
    laws: DriveLaws = LAWS,
) -> PeriodStart:
    """Hooks of command and measurement, joint controllers and their limits."""
    command, measurement, motion = inputs
    signals = signals_at(params, state, motion, 0.0, periods.control)
    command, memory = apply_hooks(hooks, "command", command, signals, state.memory)
    measurement, memory = apply_hooks(hooks, "measurement", measurement, signals, memory)
    wanted = laws.wanted_velocity(params, command, measurement)
    commanded = laws.limited_velocity(params, wanted, measurement.torque)
    commanded, memory = apply_hooks(hooks, "commanded_velocity", commanded, signals, memory)
    return PeriodStart(state._replace(memory=memory), motion, wanted, commanded)


def finish_period(
    params: DriveParams,
    state: DriveState,
    start: PeriodStart,
    hooks: DriveHooks,
    periods: LoopPeriods,
    step: float,
    tally: Tally,
    laws: DriveLaws = LAWS,
) -> tuple[DriveState, DriveOutput]:
    """Output of a period whose motor moved in steps of `step` seconds.

    The torque at the end is what the next step would put on the link. More joint velocity over the period lowers
    the torque by the spring's damping at once and by its stiffness in the mean after half the period (the steps
    look at their start); the spring's coefficients are those of the two ends of the period.
    """
    signals = signals_at(params, state, start.motion, periods.control, step)
    end_torque, signals, _ = spring_on_link(params, hooks, signals, state.memory, laws)
    before = laws.spring_coefficients(params, start.state.motor_position - start.motion.position)
    after = laws.spring_coefficients(params, signals.deflection)
    stiffness, damping = (0.5 * (first + last) for first, last in zip(before, after, strict=True))
    return state, DriveOutput(
        torque=tally.torque * (step / periods.control),
        damping=damping + stiffness * (0.5 * (periods.control - step)),
        end_torque=end_torque,
        wanted_velocity=start.wanted,
        commanded_velocity=start.commanded,
        peak_current=tally.peak_current,
        peak_voltage=tally.peak_voltage,
    )
