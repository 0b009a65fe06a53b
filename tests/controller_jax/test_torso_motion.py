"""Splines against SciPy, the hop against the physics it stands for, the torso target against its definition."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BPoly, CubicSpline

from controller_jax import torso_motion as torso
from controller_jax.gait import GaitPattern, LegPhases, ReducedGait, full_pattern, leg_phases
from controller_jax.periodic_splines import Curve, polyharmonic, quintic
from controller_jax.terrain_estimator import Plane
from controller_jax.velocity_command import VelocityCommand

GRAVITY = 9.81
FLOAT32 = 2e-5  # relative, over the sums of large kernels


def params(**changes):
    values = dict(
        height=0.44, once_per_cycle=[0.0, 0.0], twice_per_cycle=[0.0, 0.0], phase_shift=0.0, hop=1.0,
        hop_pitch=0.0, speed_lead=[0.0, 0.0], lowest_weight=0.15, stance_fade=0.7, swing_rise=0.7,
        girdle_distance=0.505, slope_share=[1.0, 1.0],
    ) | changes  # fmt: skip
    return torso.TorsoParams(**{k: jnp.asarray(v, jnp.float32) for k, v in values.items()})


def pattern(*numbers) -> GaitPattern:
    return full_pattern(ReducedGait(*(jnp.float32(x) for x in numbers)))


TROT, BOUND = pattern(0.61, 0.3, 0.3, 0.5, 0.5, 0.5), pattern(0.45, 0.35, 0.35, 0.0, 0.0, 0.5)
PHASES = np.linspace(0, 1, 401)[:-1].astype(np.float32)


def derivative(x, y):
    """Derivative of a periodic function sampled at x in [0, 1)."""
    return CubicSpline(np.append(x, 1.0), np.append(y, y[0]), bc_type="periodic")(x, 1)


def evaluate(knots):
    return jax.tree.map(np.asarray, jax.vmap(lambda x: polyharmonic(knots, x))(jnp.asarray(PHASES)))


@pytest.mark.parametrize("seed", range(5))
def test_polyharmonic_spline_solves_its_equations(seed):
    """All rows of FACTS 3.4, with the weights recovered from samples by an independent least squares."""
    knots = np.random.default_rng(seed).uniform(-0.05, 0.05, 4)
    curve = evaluate(jnp.asarray(knots, jnp.float32))
    np.testing.assert_allclose(curve.value[[0, 100, 200, 300]], knots, atol=FLOAT32)
    x = PHASES.astype(float)
    d2 = (x[:, None] - np.array([0, 0.25, 0.5, 0.75, 1.0])) ** 2
    kernels = np.where(d2 > 0, d2**2 * np.log(np.where(d2 > 0, d2, 1.0)), 0.0)
    basis = np.column_stack([kernels, np.ones_like(x), x, x * x])
    weights, *_ = np.linalg.lstsq(basis, curve.value, rcond=None)
    np.testing.assert_allclose(basis @ weights, curve.value, atol=FLOAT32 * 0.05)
    size = np.abs(weights).max()
    assert abs(weights[:5].sum()) < 1e-3 * size
    np.testing.assert_allclose(derivative(x, curve.value), curve.slope, atol=0.01 * np.abs(curve.slope).max())
    np.testing.assert_allclose(derivative(x, curve.slope), curve.curvature, atol=0.02 * np.abs(curve.curvature).max())


def test_polyharmonic_ends_join_in_value_slope_and_curvature():
    knots = jnp.asarray([0.01, -0.02, 0.03, 0.0], jnp.float32)
    start, end = polyharmonic(knots, jnp.float32(0.0)), polyharmonic(knots, jnp.float32(1.0))
    for a, b, scale in zip(start, end, (0.03, 0.3, 3.0)):
        assert abs(float(a - b)) < 1e-4 * scale


def test_quintic_is_the_hermite_polynomial():
    rng = np.random.default_rng(0)
    start, end, length = rng.standard_normal(3), rng.standard_normal(3), 0.7
    oracle = BPoly.from_derivatives([0, length], [start, end])
    x = np.linspace(0, length, 21)
    as_curve = lambda state: Curve(*(jnp.full(21, v, jnp.float32) for v in state))  # noqa: E731
    curve = quintic(as_curve(start), as_curve(end), jnp.float32(length), jnp.asarray(x, jnp.float32))
    for order, found in enumerate(curve):
        np.testing.assert_allclose(found, oracle.derivative(order)(x) if order else oracle(x), rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("duty", [0.2, 0.35, 0.5, 0.8])
def test_hop_is_free_fall_in_swing_and_the_rest_is_smooth(duty):
    x = np.linspace(0, 1, 501)[:-1]
    curve = jax.tree.map(np.asarray, torso.hop(jnp.full(500, duty, jnp.float32), jnp.asarray(x, jnp.float32)))
    swing = x >= duty
    np.testing.assert_allclose(curve.curvature[swing], -1.0, atol=1e-4)
    assert curve.curvature[~swing].min() > -1.0 - 1e-4  # a leg can only push
    np.testing.assert_allclose(derivative(x, curve.value), curve.slope, atol=1e-3)
    np.testing.assert_allclose(derivative(x, curve.slope), curve.curvature, atol=0.02 * curve.curvature.max())
    assert abs(curve.value.mean()) < 1e-5
    push = (curve.curvature + 1.0).mean()
    assert push == pytest.approx(1.0, abs=2e-3)  # the stance carries the weight of the whole stride


def test_a_leg_that_never_swings_does_not_hop():
    curve = torso.hop(jnp.ones(5), jnp.linspace(0.0, 0.9, 5))
    assert all(np.all(np.asarray(part) == 0.0) for part in curve)


def test_running_trot_has_the_published_flight():
    """FACTS 3.3: ballistic rise 1.8 cm, take-off at 0.60 m/s, mean stance force 1.67 m g."""
    phases = jnp.asarray(PHASES)
    curve = jax.vmap(lambda p: torso.girdle_heights(params(), TROT, p, jnp.float32(GRAVITY)))(phases)
    height, speed, acceleration = (np.asarray(c).mean(1) for c in curve)
    flight = np.abs(acceleration + GRAVITY) < 1e-3
    assert flight.mean() == pytest.approx(0.4, abs=0.01)
    assert speed[flight].max() == pytest.approx(0.598, abs=0.02)
    assert height[flight].max() - height[flight].min() == pytest.approx(0.018, abs=0.001)
    assert (1 + acceleration[~flight] / GRAVITY).mean() == pytest.approx(1.667, abs=0.02)


LEVEL = np.eye(3)


def target(params_, pattern_, phase, feet, plane=None, command=(0, 0, 0), R=LEVEL):
    f = lambda x: jnp.asarray(x, jnp.float32)  # noqa: E731
    phase = f(phase)
    plane = plane or Plane(f([0, 0, 1]), f([0, 0, 0]))
    command = VelocityCommand(*map(f, command))
    phases = leg_phases(pattern_, phase)
    return torso.torso_target(params_, pattern_, phases, phase, f(feet), plane, f(R), command, f(GRAVITY))


FEET = np.array([[0.26, 0.2, 0], [0.24, -0.19, 0], [-0.25, 0.21, 0], [-0.25, -0.2, 0]])


def test_velocity_and_acceleration_are_the_derivatives_of_the_height():
    p = params(once_per_cycle=[0.01, -0.02], twice_per_cycle=[0.005, 0.01], phase_shift=0.1, hop_pitch=0.4)
    T = 0.45
    run = jax.jit(lambda phase: target(p, BOUND, phase, FEET))
    grid = np.arange(0, 1, 1 / 256)
    targets = [run(jnp.float32(x)) for x in grid]
    pitch = np.array([np.arctan2(-float(t.R_WB[2, 0]), float(t.R_WB[0, 0])) for t in targets])
    height, speed, rate, acceleration, pitch_acceleration = (
        np.array([float(x) for x in values])
        for values in (
            [t.r_WB[2] for t in targets], [t.v_WB[2] for t in targets],
            [t.omega_W[1] for t in targets], [t.a_WB[2] for t in targets], [t.alpha_W[1] for t in targets],
        )
    )  # fmt: skip
    ends = np.append(grid, 1.0) * T
    of = lambda y: CubicSpline(ends, np.append(y, y[0]), bc_type="periodic")  # noqa: E731
    np.testing.assert_allclose(of(height)(ends[:-1], 1), speed, atol=0.01 * np.abs(speed).max())
    np.testing.assert_allclose(of(pitch)(ends[:-1], 1), rate, atol=0.01 * np.abs(rate).max())
    np.testing.assert_allclose(of(speed)(ends[:-1], 1), acceleration, atol=0.06 * np.abs(acceleration).max())
    turning = np.abs(pitch_acceleration).max()
    np.testing.assert_allclose(of(rate)(ends[:-1], 1), pitch_acceleration, atol=0.06 * turning)


def test_bound_pitches_nose_down_when_the_hind_hips_are_high():
    t = target(params(once_per_cycle=[-0.03, 0.03], hop=0.0), BOUND, 0.0, FEET)
    pitch = np.arctan2(0.06, 0.505)
    np.testing.assert_allclose(np.asarray(t.R_WB) @ [1, 0, 0], [np.cos(pitch), 0, -np.sin(pitch)], atol=1e-4)
    assert float(t.r_WB[2]) == pytest.approx(0.44, abs=1e-5)


def test_balance_point_weights_the_feet():
    """Walking trot, phase 0.1: LF and RH stand (stance phase 0.2), the others are early in their swing."""
    t = target(params(hop=0.0), pattern(0.8, 0.5, 0.5, 0.5, 0.5, 0.5), 0.1, FEET)
    weights = np.array([1.0, 0.15, 0.15, 1.0])
    np.testing.assert_allclose(t.r_WB[:2], (weights[:, None] * FEET[:, :2]).sum(0) / weights.sum(), atol=1e-5)


def test_weights_fade_in_late_stance_and_return_in_late_swing():
    zero, one = jnp.zeros(4), jnp.ones(4)
    stance = jnp.asarray([1.0, 1.0, 0.0, 0.0])
    at = lambda x: jnp.asarray([x, 1.0, 0.5, x], jnp.float32)  # noqa: E731
    phases = LegPhases(stance, jnp.where(stance > 0, at(0.85), one), jnp.where(stance > 0, zero, at(0.85)), one, one)
    weights = torso.foot_weights(params(), phases)
    raw = np.array([0.575, 0.15, 0.15, 0.575])
    np.testing.assert_allclose(weights, raw / raw.sum(), atol=1e-5)


def on_slope(slope):
    """Control frame (3, 3) that faces up a slope, rad, and its plane."""
    normal = np.array([-np.sin(slope), 0, np.cos(slope)])
    R_WC = np.column_stack([[np.cos(slope), 0, np.sin(slope)], [0, 1, 0], normal])
    return R_WC, Plane(jnp.asarray(normal, jnp.float32), jnp.zeros(3))


def test_slope_tilts_the_torso_along_its_command():
    R_WC, plane = on_slope(0.3)
    t = target(params(hop=0.0, speed_lead=[0.4, 0.0]), TROT, 0.1, FEET @ R_WC.T, plane, (0.4, 0.1, 0.2), R_WC)
    np.testing.assert_allclose(t.R_WB, R_WC, atol=1e-5)
    np.testing.assert_allclose(t.v_WB, R_WC @ [0.4 * 1.4, 0.1, 0], atol=1e-5)
    np.testing.assert_allclose(t.omega_W, 0.2 * R_WC[:, 2], atol=1e-5)


@pytest.mark.parametrize("behind", [-0.06, 0.0, 0.06])
def test_a_torso_that_lags_on_a_slope_is_at_its_height(behind):
    """Along the slope's normal, where the stiffness in height acts, lagging behind the feet is no error."""
    slope = 0.37
    R_WC, plane = on_slope(slope)
    t = target(params(hop=0.0), TROT, 0.1, (FEET + np.array([behind, 0, 0])) @ R_WC.T, plane, (0, 0, 0), R_WC)
    above_origin = np.array([0.0, 0.0, 0.44])  # as high above the ground, along gravity, as it should be
    assert np.asarray(t.r_WB - above_origin) @ R_WC[:, 2] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_torso_turns_with_a_share_of_the_slope(axis, share):
    """Ahead (0) or to the left (1) the ground rises: so does that axis of the torso by the share, no other."""
    slope, up = 0.35, np.array([0.0, 0.0, 1.0])
    rises, flat = np.eye(3)[axis], np.eye(3)[1 - axis]
    R_WC = np.eye(3)
    R_WC[:, axis] = np.cos(slope) * rises + np.sin(slope) * up
    R_WC[:, 2] = np.cos(slope) * up - np.sin(slope) * rises
    plane = Plane(jnp.asarray(R_WC[:, 2], jnp.float32), jnp.zeros(3))
    shares = [share, 0.5] if axis == 1 else [0.5, share]  # roll, pitch
    t = target(params(hop=0.0, slope_share=shares), TROT, 0.1, FEET @ R_WC.T, plane, (0, 0, 0), R_WC)
    turned = np.cos(share * slope) * rises + np.sin(share * slope) * up
    np.testing.assert_allclose(np.asarray(t.R_WB)[:, axis], turned, atol=1e-5)
    np.testing.assert_allclose(np.asarray(t.R_WB)[:, 1 - axis], flat, atol=1e-5)
