"""Quintic splines through evenly spaced knots (V.C.2): C4 everywhere.

n knots give n - 1 segments of degree five. Interpolation and four continuous derivatives at the inner knots leave
four conditions, two for each end: an end is "rest" (no velocity, no acceleration) or "free" (third and fourth
derivative zero: the natural end, for a motion that goes on). The polynomials are linear in the knots; that linear
map is a constant, found once in float64, and evaluating a spline is a few multiply-adds.
"""

from functools import cache
from math import factorial
from typing import Literal

import jax.numpy as jnp
import numpy as np

from controller_jax.periodic_splines import Curve
from controller_jax.types import Array

End = Literal["rest", "free"]
DEGREE = 5


@cache
def segment_coefficients(knots: int, start: End, end: End) -> np.ndarray:
    """Coefficients (knots - 1, 6, knots), power c of unit segment s per unit of knot k; knot distance 1.

    Raises ValueError for fewer than two knots or an end that is neither "rest" nor "free".
    """
    if knots < 2 or not {start, end} <= {"rest", "free"}:
        raise ValueError(f"A spline needs two knots and ends 'rest' or 'free', not {knots}, {start!r}, {end!r}.")
    segments = knots - 1
    unknowns = segments * (DEGREE + 1)
    rows: list[np.ndarray] = []
    right: list[np.ndarray] = []

    def require(terms: list[tuple[int, float, int, float]], value: np.ndarray) -> None:
        """Sum of weight * derivative of a segment at a local time, over (segment, time, order, weight)."""
        row = np.zeros(unknowns)
        for segment, x, order, weight in terms:
            for power in range(order, DEGREE + 1):
                factor = factorial(power) / factorial(power - order)
                row[segment * (DEGREE + 1) + power] += weight * factor * x ** (power - order)
        rows.append(row)
        right.append(value)

    nothing, unit = np.zeros(knots), np.eye(knots)
    for s in range(segments):
        require([(s, 0.0, 0, 1.0)], unit[s])
        require([(s, 1.0, 0, 1.0)], unit[s + 1])
    for s in range(segments - 1):
        for order in range(1, DEGREE):
            require([(s, 1.0, order, 1.0), (s + 1, 0.0, order, -1.0)], nothing)
    for kind, segment, x in ((start, 0, 0.0), (end, segments - 1, 1.0)):
        for order in (1, 2) if kind == "rest" else (3, 4):
            require([(segment, x, order, 1.0)], nothing)
    return np.linalg.solve(np.stack(rows), np.stack(right)).reshape(segments, DEGREE + 1, knots)


def quintic_spline(knots: Array, duration: Array, time: Array, start: End, end: End) -> Curve:
    """Spline through knots (n,) spread evenly over a duration (s), at a time () held within it."""
    n = knots.shape[0]
    table = jnp.asarray(segment_coefficients(n, start, end), jnp.float32)
    rate = (n - 1) / duration
    x = jnp.clip(time * rate, 0.0, n - 1.0)
    segment = jnp.minimum(x.astype(jnp.int32), n - 2)
    s = x - segment.astype(jnp.float32)
    map_ = table[segment]
    c = sum(map_[:, k] * knots[k] for k in range(n))
    value = c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * (c[4] + s * c[5]))))
    slope = c[1] + s * (2.0 * c[2] + s * (3.0 * c[3] + s * (4.0 * c[4] + s * 5.0 * c[5])))
    curvature = 2.0 * c[2] + s * (6.0 * c[3] + s * (12.0 * c[4] + s * 20.0 * c[5]))
    return Curve(value, slope * rate, curvature * rate * rate)
