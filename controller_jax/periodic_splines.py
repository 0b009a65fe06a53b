"""Splines over the cycle phase with periodic ends (V.A.3), each with its first two derivatives.

Polyharmonic (FACTS 3.4): f(x) = sum_i w_i phi((x - x_i)^2) + a + b x + c x^2 with phi(s) = s^2 ln s. It
passes through the knots, sum w = 0, value and slope agree at both ends. One freedom remains; the curvature at
the ends is made to agree too, so that the feed-forward acceleration does not jump once a cycle.

Quintic: a segment between two states (value, slope, curvature); segments that share their ends join with
continuous curvature.
"""

from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from controller_jax.types import Array

KNOT_PHASES = (0.0, 0.25, 0.5, 0.75, 1.0)  # the last knot is the first again
TINY = 1e-20  # (x - x_i)^2 at a knot, where s^2 ln s is 0


class Curve(NamedTuple):
    """A function and its derivatives at one argument."""

    value: Array
    slope: Array
    curvature: Array


def _basis(x, log):
    """Values, slopes and curvatures of the 5 kernels and of 1, x, x^2, each (8,), at x ()."""
    d = x - np.asarray(KNOT_PHASES, np.float32)
    square = d * d
    ln = log(square + np.float32(TINY))
    one, zero = x * 0 + 1, x * 0
    kernels = square * square * ln, d * square * (4 * ln + 2), square * (12 * ln + 14)
    return kernels, ((one, x, x * x), (zero, one, 2 * x), (zero, zero, 2 * one))


@cache
def _weights_of_knots() -> np.ndarray:
    """(8, 4): weights of the basis as a linear function of the four knot values; a constant, found once."""

    def row(x, order):
        kernels, polynomial = _basis(np.float64(x), np.log)
        return np.concatenate([kernels[order], polynomial[order]])

    rows = [row(x, 0) for x in KNOT_PHASES]
    rows.append(np.array([1.0] * 5 + [0.0] * 3))
    rows += [row(1.0, order) - row(0.0, order) for order in (1, 2)]
    knots = np.zeros((8, 4))
    knots[:5] = np.eye(4)[[0, 1, 2, 3, 0]]
    return np.linalg.solve(np.stack(rows), knots).astype(np.float32)


def polyharmonic(knots: Array, phase: Array) -> Curve:
    """Periodic curve through `knots` (..., 4) at phases 0, 1/4, 1/2, 3/4, at a phase () in [0, 1)."""
    kernels, polynomial = _basis(phase, jnp.log)
    # the basis at this phase in terms of the knots first: what is left for each curve are four products
    rows = [jnp.concatenate([kernel, jnp.stack(terms)]) for kernel, terms in zip(kernels, polynomial, strict=True)]
    of_knots = (jnp.stack(rows)[:, :, None] * _weights_of_knots()[None]).sum(1)  # (3, 4)
    knots = jnp.expand_dims(knots, -2)
    values = (knots * of_knots.reshape((1,) * (knots.ndim - 2) + (3, 4))).sum(-1)
    return Curve(values[..., 0], values[..., 1], values[..., 2])


def quintic(start: Curve, end: Curve, length: Array, x: Array) -> Curve:
    """Segment of given length from one state to another, at x in [0, length]; all of one shape."""
    s = x / length
    p0, p1 = start.value, end.value
    v0, v1 = start.slope * length, end.slope * length
    a0, a1 = start.curvature * length**2, end.curvature * length**2
    gap = p1 - p0 - v0 - 0.5 * a0  # what a parabola from the start leaves of value, slope and curvature
    gap_slope, gap_curvature = v1 - v0 - a0, a1 - a0
    c3 = 10.0 * gap - 4.0 * gap_slope + 0.5 * gap_curvature
    c4 = -15.0 * gap + 7.0 * gap_slope - gap_curvature
    c5 = 6.0 * gap - 3.0 * gap_slope + 0.5 * gap_curvature
    value = p0 + s * (v0 + s * (0.5 * a0 + s * (c3 + s * (c4 + s * c5))))
    slope = v0 + s * (a0 + s * (3.0 * c3 + s * (4.0 * c4 + s * 5.0 * c5)))
    curvature = a0 + s * (6.0 * c3 + s * (12.0 * c4 + s * 20.0 * c5))
    return Curve(value, slope / length, curvature / length**2)
