"""Rotations against SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from controller_jax.rotations import control_frame, cross, mm, mtv, mv, rotation_axis, rotation_log, skew

ROUNDING = 2e-6  # a few roundings of float32
NEAR_HALF_TURN = 2e-3  # rad: where the sine of the angle has lost half its digits


def test_log_agrees_with_scipy():
    rng = np.random.default_rng(0)
    axis = rng.normal(size=(300, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    for largest, tolerance in ((1.5, ROUNDING), (np.pi - NEAR_HALF_TURN, 1e-3)):
        vector = axis * rng.uniform(0, largest, (300, 1))
        R = jnp.asarray(Rotation.from_rotvec(vector).as_matrix(), jnp.float32)
        np.testing.assert_allclose(rotation_log(R), vector, atol=tolerance)


def test_log_has_finite_gradients_at_identity_and_half_turn():
    for R in (jnp.eye(3), jnp.diag(jnp.array([1.0, -1.0, -1.0]))):
        assert jnp.isfinite(jax.jacrev(rotation_log)(R)).all()


def test_products_agree_with_numpy():
    rng = np.random.default_rng(1)
    A, B = rng.normal(size=(2, 5, 3, 3)).astype(np.float32)
    v, w = rng.normal(size=(2, 5, 3)).astype(np.float32)
    np.testing.assert_allclose(mm(A, B), A @ B, atol=ROUNDING)
    np.testing.assert_allclose(mv(A, v), np.einsum("bij,bj->bi", A, v), atol=ROUNDING)
    np.testing.assert_allclose(mtv(A, v), np.einsum("bji,bj->bi", A, v), atol=ROUNDING)
    np.testing.assert_allclose(cross(jnp.asarray(v), jnp.asarray(w)), np.cross(v, w), atol=ROUNDING)
    np.testing.assert_allclose(mv(skew(jnp.asarray(v)), jnp.asarray(w)), np.cross(v, w), atol=ROUNDING)


def test_axis_rotations_agree_with_scipy():
    for axis, name in enumerate("xyz"):
        expected = Rotation.from_euler(name, 0.7).as_matrix()
        np.testing.assert_allclose(rotation_axis(jnp.float32(0.7), axis), expected, atol=ROUNDING)


def test_control_frame_is_right_handed_on_the_slope_and_faces_ahead():
    R_WB = jnp.asarray(Rotation.from_euler("zyx", [0.8, 0.2, -0.1]).as_matrix(), jnp.float32)
    normal = jnp.array([0.3, -0.1, 0.9]) / np.sqrt(0.91)
    R_WC = np.asarray(control_frame(R_WB, normal))
    np.testing.assert_allclose(R_WC.T @ R_WC, np.eye(3), atol=ROUNDING)
    np.testing.assert_allclose(np.linalg.det(R_WC), 1.0, atol=ROUNDING)
    np.testing.assert_allclose(R_WC[:, 2], normal, atol=ROUNDING)
    ahead = np.asarray(R_WB)[:, 0]
    assert R_WC[:, 0] @ ahead > 0.9
    assert abs(R_WC[:, 1] @ ahead) < ROUNDING  # the torso's x-axis has no part to the side
