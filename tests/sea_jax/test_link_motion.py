"""Link motion from noisy encoders, against a dense least-squares solution of the same estimation problem."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sea_jax import link_motion, smoothed_link_motion

PERIOD, SIGMA_Q, SIGMA_V = 2.5e-3, 2e-4, 0.02
T = 200


def noisy_log(seed: int = 0):
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(T)
    q, qd = 0.4 * np.sin(12 * t), 4.8 * np.cos(12 * t)
    return (
        (q, qd),
        (q + SIGMA_Q * rng.standard_normal(T), qd + SIGMA_V * rng.standard_normal(T)),
    )


def dense_smoother(q, v, process):
    """Most likely (q, v) of all rows at once: measurements and white acceleration as one linear system."""
    h = PERIOD
    covariance = process / h**3 * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])
    white = np.linalg.cholesky(np.linalg.inv(covariance)).T
    step = white @ np.array([[-1.0, -h, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]])
    rows, right = [], []
    for k in range(T):
        for index, value, sigma in ((2 * k, q[k], SIGMA_Q), (2 * k + 1, v[k], SIGMA_V)):
            row = np.zeros(2 * T)
            row[index] = 1.0 / sigma
            rows.append(row)
            right.append(value / sigma)
    for k in range(T - 1):
        for part in step:
            row = np.zeros(2 * T)
            row[2 * k : 2 * k + 4] = part
            rows.append(row)
            right.append(0.0)
    found = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]
    return found[::2], found[1::2]


def test_smoother_is_the_least_squares_solution():
    _, (q, v) = noisy_log()
    process = np.var(np.diff(v)) * PERIOD**2 - 2 * (PERIOD * SIGMA_V) ** 2
    expected_q, expected_v = dense_smoother(q, v, process)
    columns = (jnp.asarray(x, jnp.float32)[:, None] for x in (q, v))
    found = smoothed_link_motion(*columns, PERIOD, SIGMA_Q, SIGMA_V)
    # float32 and a variance estimated in float32: a hundredth of the noise
    np.testing.assert_allclose(found.position[:, 0], expected_q, atol=0.01 * SIGMA_Q)
    np.testing.assert_allclose(found.velocity[:, 0], expected_v, atol=0.01 * SIGMA_V)


def test_smoothing_brings_position_and_velocity_closer_to_the_truth():
    (q, qd), (noisy_q, noisy_v) = noisy_log(1)
    columns = (jnp.asarray(x, jnp.float32)[:, None] for x in (noisy_q, noisy_v))
    found = smoothed_link_motion(*columns, PERIOD, SIGMA_Q, SIGMA_V)
    assert np.std(found.position[:, 0] - q) < 0.5 * SIGMA_Q
    assert np.std(found.velocity[:, 0] - qd) < 0.9 * SIGMA_V


@pytest.mark.parametrize("smooth", [False, True])
def test_a_joint_that_never_moves_stays_finite(smooth):
    still = jnp.zeros((50, 2), jnp.float32)
    if smooth:
        found = smoothed_link_motion(still, still, PERIOD, SIGMA_Q, SIGMA_V)
    else:
        found = link_motion(still, still, PERIOD)
    assert all(np.all(np.asarray(x) == 0.0) for x in jax.tree.leaves(found))


def test_acceleration_joins_the_velocities_of_the_rows():
    rng = np.random.default_rng(2)
    q, v = (jnp.asarray(rng.standard_normal((20, 3)), jnp.float32) for _ in range(2))
    found = link_motion(q, v, PERIOD)
    reached = found.velocity[:-1] + PERIOD * found.acceleration[:-1]
    np.testing.assert_allclose(reached, v[1:], rtol=0, atol=1e-5)
    assert found.acceleration.shape == q.shape
