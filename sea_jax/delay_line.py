"""What was a while ago, between rows: linear interpolation in the last few control periods."""

import jax.numpy as jnp

from sea_jax.types import Array

LONGEST = 8  # control periods that a history holds beside the present: 20 ms at 400 Hz


def delayed(history: Array, delay_in_periods: Array) -> Array:
    """A history (places, LONGEST + 1), newest first, at a delay in periods (places,), linear between its entries."""
    age = jnp.arange(LONGEST + 1, dtype=history.dtype)[None, :]
    late = delay_in_periods[:, None] - age
    # a hat around each age, written so that its slope at a whole number of periods is that towards later
    weight = jnp.where(late < 0.0, 1.0 + late, 1.0 - late)
    inside = (late >= -1.0) & (late < 1.0)
    return jnp.where(inside, weight * history, 0.0).sum(-1)
