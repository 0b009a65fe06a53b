"""Quintic splines against SciPy's B-splines with the same end conditions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from controller_jax.splines import quintic_spline, segment_coefficients

ENDS = {"rest": [(1, 0.0), (2, 0.0)], "free": [(3, 0.0), (4, 0.0)]}
ROUNDING = 1e-5  # float32, relative to the largest value of the curve; the coefficients reach tens


@pytest.mark.parametrize("knots", [3, 8])
@pytest.mark.parametrize("start", ENDS)
@pytest.mark.parametrize("end", ENDS)
def test_value_slope_and_curvature_agree_with_scipy(knots, start, end):
    y = np.random.default_rng(knots).uniform(0.22, 0.55, knots)
    duration = 0.4
    x = np.linspace(0, duration, knots)
    oracle = make_interp_spline(x, y, k=5, bc_type=(ENDS[start], ENDS[end]))
    times = np.linspace(0, duration, 101)
    evaluate = jax.jit(
        jax.vmap(lambda t: quintic_spline(jnp.asarray(y, jnp.float32), jnp.float32(duration), t, start, end))
    )
    ours = evaluate(jnp.asarray(times, jnp.float32))
    for order, values in enumerate(ours):
        expected = oracle(times, order)
        np.testing.assert_allclose(values, expected, atol=ROUNDING * np.abs(expected).max() * 10**order)


def test_beyond_the_ends_the_spline_is_held():
    knots = jnp.linspace(0.3, 0.5, 8)
    for time, knot in ((-1.0, 0), (9.0, -1)):
        curve = quintic_spline(knots, jnp.float32(0.4), jnp.float32(time), "rest", "rest")
        np.testing.assert_allclose(curve.value, knots[knot], atol=1e-5)
        np.testing.assert_allclose([curve.slope, curve.curvature], 0.0, atol=1e-2)


def test_gradient_with_respect_to_knots_and_time_is_the_curve_itself():
    knots, duration = jnp.asarray([0.3, 0.5, 0.4]), jnp.float32(0.5)
    time = jnp.float32(0.17)
    slope = jax.grad(lambda t: quintic_spline(knots, duration, t, "rest", "free").value)(time)
    np.testing.assert_allclose(slope, quintic_spline(knots, duration, time, "rest", "free").slope, rtol=1e-5)


def test_impossible_splines_are_refused():
    with pytest.raises(ValueError, match="two knots"):
        segment_coefficients(1, "rest", "free")
    with pytest.raises(ValueError, match="rest"):
        segment_coefficients(3, "rest", "loose")
