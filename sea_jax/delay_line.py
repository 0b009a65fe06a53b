"""What was a while ago, or will be, between rows: interpolation over a few control periods."""

from collections.abc import Callable

import jax.numpy as jnp

from sea_jax.types import Array, JointMotion

LONGEST = 8  # control periods that a history holds beside the present: 20 ms at 400 Hz


def delayed(history: Array, delay_in_periods: Array) -> Array:
    """A history (places, LONGEST + 1), newest first, at a delay in periods (places,), linear between its entries.

    What was before the oldest entry is the oldest.
    """
    age = jnp.arange(LONGEST + 1, dtype=history.dtype)[None, :]
    return (_hat(_within(delay_in_periods)[:, None] - age) * history).sum(-1)


def earlier(rows: Array, periods: Array) -> Array:
    """Rows (T, J) as they stood so many whole periods (J,) before, at most LONGEST; what was before the first row is
    the first."""
    periods = _within(periods)
    first = jnp.repeat(rows[:1], LONGEST, 0)
    known = jnp.concatenate([first, rows])
    count = len(rows)
    return _summed(lambda k: known[LONGEST - k : LONGEST - k + count], lambda k: jnp.equal(periods, k), rows)


def later(rows: Array, periods: Array) -> Array:
    """Rows (T, J) as they stand so many periods (J,) afterwards, at most LONGEST, linear in between; the last row
    stays."""
    periods = _within(periods)
    return _summed(_ahead(rows), lambda k: _hat(periods - k), rows)


def motion_later(motion: JointMotion, time: Array, period: float) -> JointMotion:
    """Motion on rows (T, J) as it is `time` (J,) s afterwards, 0 to LONGEST periods: positions by the cubic through two
    rows' positions and velocities, the others linear in between."""
    periods = _within(time / period)
    cubic = _summed(_ahead(motion.position), lambda k: _cubic(periods - k), motion.position)
    turned = _summed(_ahead(motion.velocity), lambda k: _slope(periods - k), motion.velocity)
    return JointMotion(
        cubic + period * turned,
        later(motion.velocity, periods),
        later(motion.acceleration, periods),
        later(motion.radial_load, periods),
    )


def _ahead(rows: Array) -> Callable[[int], Array]:
    """Rows as they stand k rows afterwards."""
    known = jnp.concatenate([rows, jnp.repeat(rows[-1:], LONGEST, 0)])
    return lambda k: known[k : k + len(rows)]


def _summed(at: Callable[[int], Array], weight: Callable[[int], Array], like: Array) -> Array:
    total = jnp.zeros_like(like)
    for k in range(LONGEST + 1):
        total = total + weight(k).astype(like.dtype)[None] * at(k)
    return total


def _within(periods: Array) -> Array:
    """Periods that a history reaches. Not jnp.clip, which halves the slope at 0, where fits start."""
    return jnp.where(periods < 0.0, 0.0, jnp.where(periods < LONGEST, periods, float(LONGEST)))


def _hat(late: Array) -> Array:
    """1 at 0, down to 0 at -1 and 1, written so that its slope at 0 is that towards later."""
    return jnp.where((late >= -1.0) & (late < 1.0), jnp.where(late < 0.0, 1.0 + late, 1.0 - late), 0.0)


def _cubic(late: Array) -> Array:
    """Weight of a row's position in Hermite's cubic between it and its neighbours."""
    away = jnp.abs(late)
    return jnp.where(away < 1.0, 1.0 - away * away * (3.0 - 2.0 * away), 0.0)


def _slope(late: Array) -> Array:
    """Weight of a row's velocity times the period."""
    away = 1.0 - jnp.abs(late)
    return jnp.where(away > 0.0, late * away * away, 0.0)
