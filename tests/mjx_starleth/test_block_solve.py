"""The hand-written elimination against NumPy's dense solve."""

import jax
import numpy as np
import pytest

from mjx_starleth.block_solve import factor, inverse3, solve

ROUNDING = 2e-5  # relative; float32 on matrices of condition number up to 1e3


def robot_like_matrix(seed: int) -> np.ndarray:
    """Positive definite (18, 18) with a full base and legs that see only the base and themselves."""
    rng = np.random.default_rng(seed)
    m = np.zeros((18, 18))
    for leg in range(4):
        rows = [0, 1, 2, 3, 4, 5, *range(6 + 3 * leg, 9 + 3 * leg)]
        a = rng.normal(size=(9, 9))
        m[np.ix_(rows, rows)] += a @ a.T + 0.3 * np.eye(9)
    return m


@pytest.mark.parametrize("seed", range(5))
def test_solve_against_numpy(seed):
    m = robot_like_matrix(seed)
    b = np.random.default_rng(seed + 100).normal(size=18)
    legs = [slice(6 + 3 * leg, 9 + 3 * leg) for leg in range(4)]
    blocks = np.float32(m[:6, :6]), np.float32([m[k, :6] for k in legs]), np.float32([m[k, k] for k in legs])
    base, leg = jax.jit(lambda m_, b_, l_: solve(factor(*m_), b_, l_))(
        blocks, np.float32(b[:6]), np.float32(b[6:].reshape(4, 3))
    )
    exact = np.linalg.solve(m, b)
    found = np.concatenate([base, np.ravel(leg)])
    np.testing.assert_allclose(found, exact, atol=ROUNDING * np.linalg.cond(m) ** 0.5 * np.abs(exact).max())


def test_inverse_of_small_symmetric_matrices():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(50, 3, 3))
    a = a @ a.transpose(0, 2, 1) + 0.2 * np.eye(3)
    np.testing.assert_allclose(inverse3(np.float32(a)) @ a, np.broadcast_to(np.eye(3), a.shape), atol=2e-4)
