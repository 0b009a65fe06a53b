"""What a controller knows of its torque sensors: where a model has learned how they err, it asks for what they show.

The joint controllers close their loops on the sensors: a torque is reached when it is read.
"""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.types import JointTargets
from experiments.effects.compose import ActiveEffects, EffectNumbers, activate
from experiments.effects.library import LIBRARY
from experiments.model import Model
from sea_jax import JointMeasurement

ERRORS = ("torque_sensor_gain", "torque_sensor_offset")


class TorqueSensors(NamedTuple):
    """Sensors that err in a known way."""

    effects: ActiveEffects
    numbers: EffectNumbers


def known_torque_sensors(model: Model) -> TorqueSensors | None:
    """The sensors as the model has learned them; None where it says nothing of them: a rollout then keeps its bits."""
    effects, numbers, _ = activate([placed for placed in model.effects if placed.effect in ERRORS], LIBRARY)
    return TorqueSensors(effects, numbers) if effects.effects else None


def as_read(sensors: TorqueSensors | None, targets: JointTargets) -> JointTargets:
    """Joint targets whose torques (12,), N m, are what the sensors show of the wanted ones."""
    if sensors is None:
        return targets
    nothing = jnp.zeros_like(targets.torque)
    wanted = JointMeasurement(nothing, nothing, targets.torque, nothing)
    return targets._replace(torque=sensors.effects.apply("measurement", sensors.numbers, wanted).torque)
