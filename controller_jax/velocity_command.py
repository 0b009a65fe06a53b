"""Commanded velocity in the control frame (V.A.2), bounded and smoothed (FACTS 3.4), and met in the mean.

Footholds and virtual damping pull the torso towards the commanded velocity like a spring: what every stride takes
away again stays as an error. A slow integrator learns it and adds it to what is asked of them.
"""

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
    """Bounds, smoothing and integrator; each in the order heading, lateral, turning."""

    maximum: VelocityCommand
    smoothing: VelocityCommand  # share of the remaining difference taken in one control period
    trim_rate: VelocityCommand  # 1/s at which the trim integrates the error; slow against a stride
    most_trim: VelocityCommand  # clamp of the trim against windup


def smoothed_command(params: VelocityParams, current: VelocityCommand, wanted: VelocityCommand) -> VelocityCommand:
    """One control period of a first-order approach to the bounded command."""

    def approach(bound, share, now, goal):
        return now + share * (jnp.clip(goal, -bound, bound) - now)

    return jax.tree.map(approach, params.maximum, params.smoothing, current, wanted)


def integrated_trim(
    params: VelocityParams, trim: VelocityCommand, command: VelocityCommand, measured: VelocityCommand, period: Array
) -> VelocityCommand:
    """Trim after one control period (s) of the torso's velocity being `measured` where `command` was due."""

    def integrate(rate, most, so_far, due, now):
        return jnp.clip(so_far + period * rate * (due - now), -most, most)

    return jax.tree.map(integrate, params.trim_rate, params.most_trim, trim, command, measured)
