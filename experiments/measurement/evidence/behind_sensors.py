"""What joint sensors would show without their effects: the links' motion and the joints' torque, on rows of a log."""

import jax
import jax.numpy as jnp

from experiments.effects.compose import ActiveEffects, EffectNumbers
from sea_jax import JointMeasurement, JointMotion, Timing
from sea_jax.delay_line import later, motion_later
from sea_jax.hooks import link_signals

Array = jax.Array


def behind_sensors(
    effects: ActiveEffects, numbers: EffectNumbers, motion: JointMotion, torque: Array, period: float
) -> tuple[JointMotion, Array]:
    """True motion and true torque (T, J) of what was logged every `period` [s]."""
    true_motion = jax.vmap(lambda row: effects.apply("measured_motion", numbers, row))(motion)
    true_torque = jax.vmap(lambda m, t: _unshown(effects, numbers, m, t, period))(motion, torque)
    still = jnp.zeros(torque.shape[1], torque.dtype)
    timing = effects.apply("replay_timing", numbers, Timing(*(still,) * 4))
    return motion_later(true_motion, timing.link_age, period), later(true_torque, timing.drive_age / period)


def _unshown(
    effects: ActiveEffects, numbers: EffectNumbers, motion: JointMotion, torque: Array, period: float
) -> Array:
    """Torque (J,) behind the torque sensor: every memoryless sensor effect is affine in it (HOOKS)."""
    zero = jnp.zeros_like(torque)
    signals = link_signals(motion, period)

    def shown(true: Array) -> Array:
        measurement = JointMeasurement(motion.position, motion.velocity, true, motion.position)
        for effect, values in zip(effects.effects, numbers, strict=True):
            if "measurement" in effect.equations and not effect.memory:
                measurement = ActiveEffects((effect,)).apply("measurement", (values,), measurement, signals)
        return measurement.torque

    offset = shown(zero)
    return (torque - offset) / (shown(zero + 1.0) - offset)
