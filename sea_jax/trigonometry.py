"""Sine and cosine that compilers vectorise: XLA calls the C library for them, one number after the other.

Cody and Waite's reduction to an eighth of a turn and Cephes' polynomials (netlib.org/cephes, sinf.c): exact to 2e-7
for angles up to 8000 rad, beyond which single precision knows no angle to better than 5e-4 rad anyway.
"""

import jax.numpy as jnp

from sea_jax.types import Array

QUARTER_PER_RAD = 0.6366197723675814
QUARTER = (1.5703125, 4.837512969970703e-4, 7.549789954892e-8)  # of a turn in rad: parts of few digits, largest first


def sine_cosine(angle: Array) -> tuple[Array, Array]:
    """Sine and cosine of an angle in rad, any shape, single precision."""
    quarters = jnp.round(angle * QUARTER_PER_RAD)
    x = angle
    for part in QUARTER:
        x = x - quarters * part
    square = x * x
    sine = x + x * square * (-1.6666654611e-1 + square * (8.3321608736e-3 - square * 1.9515295891e-4))
    fourth = 4.166664568298827e-2 + square * (square * 2.443315711809948e-5 - 1.388731625493765e-3)
    cosine = 1.0 - 0.5 * square + square * square * fourth
    turn = quarters - 4.0 * jnp.floor(0.25 * quarters)  # 0, 1, 2 or 3 quarters
    odd = jnp.abs(turn - 2.0) == 1.0
    first, second = jnp.where(odd, cosine, sine), jnp.where(odd, sine, cosine)
    return jnp.where(turn >= 2.0, -first, first), jnp.where(jnp.abs(turn - 1.5) < 1.0, -second, second)
