"""The smooth counterparts of the laws that have corners and jumps, each with the width over which it is rounded."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

Array = jax.Array


class Widths(NamedTuple):
    """Over how much of its argument each law is rounded; every law tends to the hard one as its width goes to zero."""

    contact_impulse: float = 0.01  # N s: corner of the unilateral contact, a twentieth of a standing foot's impulse
    contact_force: float = 2.0  # N around the threshold of the contact flags
    take_off: float = 12.0  # N as a foot leaves the ground: what its force falls by in half a tick
    rate: float = 0.02  # m/s around the thresholds on the torso's vertical velocity
    time: float = 2.5e-3  # s around switching times that depend on the motion: a tick
    current: float = 0.2  # A at the limits of current and integrators
    velocity: float = 0.05  # rad/s at speed, power and voltage limits
    stick: float = 0.02  # rad/s: motor velocity within which gear friction turns from sticking to slipping
    deflection: float = 2e-3  # rad around zero, where a one-sided spring meets its stop
    torque: float = 0.2  # N m at the controller's torque limits
    force: float = 1.0  # N at the limits of the force distribution
    share: float = 0.01  # of a quantity without unit: use of the friction cone
    angle: float = 2e-3  # rad at the joint stops' margin


WIDTHS = Widths()


def softplus(x: Array, width: float) -> Array:
    """max(x, 0) with its corner rounded; always above it, by 0.69 widths at the corner."""
    return width * jax.nn.softplus(x / width)


def step(x: Array, width: float) -> Array:
    """0 for x < 0, 1 for x > 0, in between over a few widths."""
    return jax.nn.sigmoid(x / width)


def clip(x: Array, low: Array, high: Array, width: float) -> Array:
    """Between low and high, with rounded corners; exact in the middle of limits that are symmetric."""
    return low + softplus(x - low, width) - softplus(x - high, width)


def shrink_to(length: Array, limit: Array) -> Array:
    """Factor that brings a length > 0 below a limit > 0: min(1, limit / length), rounded; 0.92 at the corner."""
    larger = jax.lax.stop_gradient(jnp.maximum(length, limit))  # keeps the powers finite, cancels
    a, b = length / larger, limit / larger
    return b * (a**SHARPNESS + b**SHARPNESS) ** (-1.0 / SHARPNESS)


SHARPNESS = 8


def any_of(x: Array) -> Array:
    """1 if any of the shares (n,) in [0, 1] is 1."""
    return 1.0 - jnp.prod(1.0 - x)
