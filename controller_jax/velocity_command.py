"""Commanded velocity in the control frame (V.A.2), bounded and smoothed (FACTS 3.4)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from controller_jax.types import Array


class VelocityCommand(NamedTuple):
    """What the operator asks for, along and about the axes of the control frame; every field ()."""

    heading: Array  # m/s
    lateral: Array  # m/s, to the left
    turning: Array  # rad/s, to the left


class VelocityParams(NamedTuple):
    """Bounds and smoothing; both in the order heading, lateral, turning."""

    maximum: VelocityCommand
    smoothing: VelocityCommand  # share of the remaining difference taken in one control period


def smooth(params: VelocityParams, current: VelocityCommand, wanted: VelocityCommand) -> VelocityCommand:
    """One control period of a first-order approach to the bounded command."""

    def approach(bound, share, now, goal):
        return now + share * (jnp.clip(goal, -bound, bound) - now)

    return jax.tree.map(approach, params.maximum, params.smoothing, current, wanted)
