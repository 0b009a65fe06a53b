"""The filter against simulated motions that know nothing of it: is it as good as it says it is?"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from controller_jax import state_estimator as ekf

PERIOD, TICKS, RUNS = 2.5e-3, 1200, 64
SLIP_FROM = 400  # ticks
GRAVITY = np.array([0.0, 0.0, -9.81])
PARAMS = ekf.EstimatorParams(
    gyro=0.01,
    accelerometer=0.1,
    gyro_bias_walk=1e-3,
    accelerometer_bias_walk=5e-3,
    foot_velocity=0.05,
    outlier=16.3,  # 99.9 % of standing feet pass
    initial=np.array([0.03, 0.1, 0.02, 0.2]),
)
PARAMS = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), PARAMS)
# Mean NEES over the runs against chi-square. Runs are independent, ticks of one run are not, so every checked
# tick has to lie in a band that a consistent filter leaves once in 10^4 ticks.
BAND = chi2.ppf([5e-5, 1 - 5e-5], 12 * RUNS) / RUNS


def torso_motion(rng):
    """Lively random motion: R (T, 3, 3), r, v (T, 3) with r, v, R sampled at the ticks."""
    t = np.arange(TICKS + 1) * PERIOD
    frequency, phase = rng.uniform(0.5, 3.0, (2, 3, 4)), rng.uniform(0, 2 * np.pi, (2, 3, 4))
    size = np.array([0.05, 0.12])[:, None, None] / frequency * rng.uniform(0.3, 1.0, (2, 3, 4))
    waves = (size[..., None] * np.sin(2 * np.pi * frequency[..., None] * t + phase[..., None])).sum(2)
    r = waves[0].T + np.outer(t, [0.5, 0.1, 0.0]) + [0, 0, 0.42]
    heading = rng.uniform(-np.pi, np.pi)
    R = Rotation.from_euler("z", heading) * Rotation.from_rotvec(waves[1].T)
    return R, r


def simulate(seed, slip=False):
    """Truth and readings of one run; the feet of two pairs stand by turns, at rest but for LF if it slips."""
    rng = np.random.default_rng(seed)
    R, r = torso_motion(rng)
    v = np.gradient(r, PERIOD, axis=0)
    normal = rng.standard_normal
    omega = (R[:-1].inv() * R[1:]).as_rotvec() / PERIOD
    acceleration = np.diff(v, axis=0) / PERIOD
    force = R[1:].inv().apply(acceleration - GRAVITY)
    R, r, v = R[1:], r[1:], v[1:]
    walk = np.sqrt(PERIOD) * normal((TICKS, 2, 3)).cumsum(0)
    bias_g = 0.02 * normal(3) + float(PARAMS.gyro_bias_walk) * walk[:, 0]
    bias_a = 0.2 * normal(3) + float(PARAMS.accelerometer_bias_walk) * walk[:, 1]
    gyro = omega + bias_g + 0.01 * normal((TICKS, 3))
    accelerometer = force + bias_a + 0.1 * normal((TICKS, 3))
    corners = np.array([[x, y, -0.42] for x in (0.25, -0.25) for y in (0.2, -0.2)])
    turn = np.arange(TICKS) // 100
    foot = r[turn * 100][:, None] + np.einsum("tij,fj->tfi", R[turn * 100].as_matrix(), corners)
    pair = np.array([0, 1, 1, 0])
    contact = (pair[None] == (turn % 2)[:, None]).astype(float)
    to_B = R.inv().as_matrix()
    r_BS = np.einsum("tij,tfj->tfi", to_B, foot - r[:, None])
    v_W = np.zeros((TICKS, 4, 3))
    if slip:
        v_W[SLIP_FROM:, 0] = [0.6, 0.0, 0.0]
    v_BS = np.einsum("tij,tfj->tfi", to_B, v_W - v[:, None]) - np.cross(omega[:, None], r_BS)
    v_BS += 0.05 * normal((TICKS, 4, 3))
    truth = R.as_matrix(), v, bias_g, bias_a
    start_R = (Rotation.from_rotvec(0.03 * normal(3)).inv() * R[0]).as_matrix()
    start = r[0], start_R, v[0] + 0.1 * normal(3)
    return start, (gyro, accelerometer, contact, r_BS, v_BS), truth


@cache
def filter_program(every=40):
    """Vmapped filter: estimates and covariances every few ticks."""

    def run(start, data):
        state = ekf.init(PARAMS, *start)

        def tick(state, row):
            gyro, force, contact, r_BS, v_BS = row
            reading = ekf.SensorReading(gyro, force, jnp.zeros(12), jnp.zeros(12), contact)
            state = ekf.predict(PARAMS, state, reading, jnp.float32(9.81), jnp.float32(PERIOD))
            state, info = ekf.correct(PARAMS, state, reading, r_BS, v_BS)
            return state, (state, info)

        states, info = jax.lax.scan(tick, state, data)[1]
        return jax.tree.map(lambda x: x[::every], states), info

    return jax.jit(jax.vmap(run))


def run_filter(simulations):
    start, data, _ = jax.tree.map(lambda *x: np.stack(x).astype(np.float32), *simulations)
    return jax.tree.map(np.asarray, filter_program()(start, data))


def errors(states, truth):
    """Error of every run and kept tick, (runs, ticks, 12), in the filter's own definition."""
    R, v, bias_g, bias_a = (x[:, ::40] for x in truth)
    theta = Rotation.from_matrix((R @ states.R_WB.swapaxes(-1, -2)).reshape(-1, 3, 3))
    turned = theta.apply(states.v_WB.reshape(-1, 3)).reshape(v.shape)
    theta = theta.as_rotvec().reshape(v.shape)
    return np.concatenate([theta, v - turned, bias_g - states.gyro_bias, bias_a - states.accelerometer_bias], -1)


@pytest.fixture(scope="module")
def consistent_runs():
    simulations = [simulate(seed) for seed in range(RUNS)]
    states, info = run_filter(simulations)
    truth = jax.tree.map(lambda *x: np.stack(x), *[s[2] for s in simulations])
    return states, info, errors(states, truth)


def test_nees_is_chi_square(consistent_runs):
    states, _, error = consistent_runs
    nees = np.einsum("rti,rti->rt", error, np.linalg.solve(states.covariance.astype(float), error[..., None])[..., 0])
    mean = nees.mean(0)
    assert np.all((mean > BAND[0]) & (mean < BAND[1])), (BAND, mean.min(), mean.max())


def test_feet_make_velocity_and_tilt_known(consistent_runs):
    _, _, error = consistent_runs
    late = error[:, 20:]
    assert late[..., 3:6].std() < 0.02  # m/s: 2.5 times better than one foot's velocity noise
    assert late[..., :2].std() < 0.01  # rad of tilt, from 0.03 at the start


def test_standing_feet_pass_and_a_slipping_foot_is_rejected(consistent_runs):
    _, info, _ = consistent_runs
    rejected = 1.0 - info.used.mean() / 0.5  # two of four feet stand at any time
    assert 0.0003 < rejected < 0.003, rejected  # 0.001 by the threshold
    simulations = [simulate(seed, slip=True) for seed in range(8)]
    _, slipping = run_filter(simulations)
    contact = np.stack([s[1][2] for s in simulations])
    settled = slice(SLIP_FROM, None)
    used = slipping.used[:, settled].sum((0, 1)) / contact[:, settled].sum((0, 1))
    assert used[0] < 0.01 and used[1:].min() > 0.99, used


def test_prediction_alone_follows_a_noiseless_motion():
    """Strap-down integration of exact readings against the motion they came from, 1 s without a foot."""
    rng = np.random.default_rng(3)
    R, r = torso_motion(rng)
    v = np.gradient(r, PERIOD, axis=0)
    omega = (R[:-1].inv() * R[1:]).as_rotvec() / PERIOD
    force = R[1:].inv().apply(np.diff(v, axis=0) / PERIOD - GRAVITY)
    data = [np.zeros((400, *s), np.float32) for s in ((3,), (3,), (4,), (4, 3), (4, 3))]
    data[0], data[1] = omega[:400].astype(np.float32), force[:400].astype(np.float32)
    start = [x.astype(np.float32)[None] for x in (r[0], R[0].as_matrix(), v[0])]
    states, _ = filter_program(1)(start, [d[None] for d in data])
    # float32 rounding over 400 products
    np.testing.assert_allclose(states.R_WB[0, -1], R[400].as_matrix(), atol=2e-5)
    np.testing.assert_allclose(states.v_WB[0, -1], v[400], atol=2e-4)
    np.testing.assert_allclose(states.r_WB[0, -1], r[400], atol=5e-4)
