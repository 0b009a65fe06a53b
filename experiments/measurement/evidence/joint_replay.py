"""A rigid joint on a bench: its equation of motion evaluated on what was measured.

    effort = J a + c0 sgn(v) + c1 v + G sin(q) + effects

with sticking where the joint stands. What is left over is the residual, in the unit of the effort.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import butter, sosfiltfilt

from experiments.effects.compose import ActiveEffects, EffectNumbers
from experiments.errors import UserError
from experiments.measurement.logs.log import Log
from experiments.model import JointNumbers
from mjx_starleth.numbers import load_numbers
from sea_jax import DriveParams, JointCommand, JointMotion, params_from_numbers
from sea_jax.friction import coulomb_level, gear_friction
from sea_jax.hooks import DriveHooks, Signals, apply_hooks, no_signals

Array = jax.Array

LOWEST, HIGHEST = 8.0, 100.0  # Hz of the zero-phase filter's corner
RESOLVED = 0.15  # of the sampling rate: the highest corner that the rows resolve
LOUD = 0.1  # of the effort: what the encoder's noise may add to it through the acceleration
WIDER = 2.0
HIGHEST_SHARE = 0.45  # of the sampling rate, for any filter
ORDER = 4
LEAST_GAIN = 0.1  # of the torque constant
STILL = 0.01  # of the largest speed, below which the joint may stand


class JointLog(NamedTuple):
    """One joint; every array (T,) float32: rad (m), rad/s, rad/s^2, N m (N)."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    effort: np.ndarray


@dataclass(frozen=True, eq=False)
class JointReplay:
    """Numbers of the joint as those of a drive with gear 1, its gravity load, and the effects that may act."""

    params: DriveParams
    gravity_load: float
    effects: ActiveEffects
    period: float

    def residual(self, log: JointLog, still: Array, numbers: EffectNumbers) -> Array:
        """Effort that nothing accounts for, (T,). still: speed below which the joint may stand."""
        params = self.effects.apply("drive_parameters", numbers, self.params)
        hooks = self.effects.drive_hooks(numbers)

        def step(memory, row):
            row = JointLog(*(x[None] for x in row))
            nothing = jnp.zeros(1, jnp.float32)
            motion = JointMotion(row.position, row.velocity, row.acceleration, nothing)
            motion = self.effects.apply("measured_motion", numbers, motion)
            blind = no_signals(nothing, self.period)
            command = JointCommand(row.effort, nothing, nothing)
            command, memory = apply_hooks(hooks, "command", command, blind, memory)
            seen = blind._replace(
                motor_position=motion.position,
                motor_velocity=motion.velocity,
                joint_position=motion.position,
                joint_velocity=motion.velocity,
                current=command.torque,
                spring_torque=command.torque,
            )
            effort, gain, memory = _at_the_motor(hooks, seen, command.torque, memory)
            friction = gear_friction(params, coulomb_level(params, nothing), motion.velocity)
            friction, memory = apply_hooks(hooks, "friction", friction, seen, memory)
            drag = self.effects.apply("joint_drag", numbers, nothing, seen)
            load = params.motor_inertia * motion.acceleration + self.gravity_load * jnp.sin(motion.position)
            free = effort - load - friction.smooth - drag
            level = jnp.maximum(friction.coulomb, 0.0)
            standing = free - jnp.clip(free, -level, level)
            moving = free - level * jnp.sign(motion.velocity)
            left = jnp.where(jnp.abs(motion.velocity) < still, standing, moving)
            # as an error of what was measured: else the smallest gain would leave the least of its noise
            return memory, (left / jnp.maximum(gain, LEAST_GAIN))[0]

        return jax.lax.scan(step, self.effects.memory(1), log)[1]


def _at_the_motor(hooks: DriveHooks, seen: Signals, measured: Array, memory: dict) -> tuple[Array, Array, dict]:
    """Effort behind the effects on the motor, its slope over the measured one, and their memory."""

    def driving(torque: Array) -> tuple[Array, dict]:
        return apply_hooks(hooks, "motor_torque", torque, seen._replace(current=torque, spring_torque=torque), memory)

    return jax.jvp(driving, (measured,), (jnp.ones_like(measured),), has_aux=True)


def rigid_drive(joint: JointNumbers) -> DriveParams:
    """A joint's numbers as those of a drive with gear 1 and no dry friction. Only inertia and friction count."""
    one = jax.tree.map(lambda x: x[:1], params_from_numbers(load_numbers().model_dump(mode="json")))
    number = lambda value: jnp.full(1, value, jnp.float32)  # noqa: E731
    return one._replace(
        gear_ratio=number(1.0),
        motor_inertia=number(joint.inertia),
        friction_coulomb=number(0.0),
        friction_viscous=number(joint.viscous_friction),
        friction_cubic=number(0.0),
    )


def raw_rows(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Position and effort (T,) of a bench log. Raises UserError where one is missing.

    An effort is held until the next row: the mean of the one before and the one after acts at the row's time.
    """
    tables = [log.joints("joint_position"), log.joints("applied_torque")]
    for name, table in zip(("joint_position", "applied_torque"), tables, strict=True):
        if table is None or np.isnan(table).all():
            raise UserError(f"{log.name}: a rigid joint cannot be judged without '{name}'; log it.")
    position, effort = (np.nan_to_num(table[:, 0]) for table in tables)
    return position, 0.5 * (effort + np.concatenate([effort[:1], effort[:-1]]))


def corner(inertia: float, effort: float, noise: float, period: float) -> float:
    """Corner frequency in Hz at which the encoder's noise, twice differentiated, is a LOUD part of the effort.

    White noise below f gives an acceleration of noise (2 pi)^2 sqrt(2 period f^5 / 5).
    """
    ratio = LOUD * effort / (inertia * noise * (2.0 * np.pi) ** 2) if noise > 0 else np.inf
    loud = (2.5 * ratio**2 / period) ** 0.2
    return float(min(np.clip(loud, LOWEST, HIGHEST), RESOLVED / period))


def moving(position: np.ndarray, effort: np.ndarray, frequency: float, period: float) -> JointLog:
    """Motion by central differences behind a filter of WIDER times the frequency at which all residuals are filtered.

    Effort and friction, which jump, then pass one filter alike; the motion's own is flat where that one passes.
    """
    smooth = low_pass(position, min(WIDER * frequency, HIGHEST_SHARE / period), period)
    velocity = np.gradient(smooth, period)
    acceleration = np.gradient(velocity, period)
    return JointLog(*(np.float32(x) for x in (smooth, velocity, acceleration, effort)))


def low_pass(values: np.ndarray, frequency: float, period: float) -> np.ndarray:
    """Zero-phase Butterworth filter along the last axis."""
    sections = butter(ORDER, frequency, fs=1.0 / period, output="sos")
    return sosfiltfilt(sections, values, axis=-1)
