"""The plane against NumPy's least squares, its filter against the exponential, the control frame's definition."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from controller_jax import terrain_estimator as terrain
from controller_jax.rotations import control_frame

ROUNDING = 2e-5  # unit normals from float32 footholds metres away from the origin
FEET = np.array([[0.25, 0.2], [0.25, -0.2], [-0.25, 0.2], [-0.25, -0.2]])


def test_plane_is_the_least_squares_plane():
    rng = np.random.default_rng(0)
    cases = 300
    xy = FEET + rng.uniform(-0.12, 0.12, (cases, 4, 2)) + rng.uniform(-5, 5, (cases, 1, 2))
    z = (xy * rng.uniform(-0.5, 0.5, (cases, 1, 2))).sum(-1) + rng.uniform(-0.05, 0.05, (cases, 4))
    probe = rng.uniform(-0.5, 0.5, (cases, 2)) + xy.mean(1)
    points = np.concatenate([xy, z[..., None]], -1)
    planes = jax.jit(jax.vmap(terrain.fit_plane))(jnp.asarray(points, jnp.float32))
    heights = jax.vmap(terrain.height_at)(planes, jnp.asarray(np.column_stack([probe, z[:, 0]]), jnp.float32))
    for k in range(cases):
        (a, b, d), *_ = np.linalg.lstsq(np.column_stack([-xy[k], np.ones(4)]), z[k], rcond=None)
        normal = np.array([a, b, 1.0]) / np.sqrt(a * a + b * b + 1)
        np.testing.assert_allclose(planes.normal_W[k], normal, atol=ROUNDING)
        np.testing.assert_allclose(heights[k], d - a * probe[k, 0] - b * probe[k, 1], atol=ROUNDING)


def test_footholds_in_a_line_give_level_ground():
    line = jnp.asarray([[0.1 * k, 0.0, 0.02 * k] for k in range(4)], jnp.float32)
    plane = terrain.fit_plane(line)
    assert np.all(np.isfinite(plane.normal_W)) and plane.normal_W[2] > 0.99


def test_filter_has_its_time_constant():
    params, period = terrain.TerrainParams(jnp.float32(0.05)), jnp.float32(0.0025)
    footholds = jnp.asarray([[x, y, 0.1 * x + 0.3] for x, y in FEET], jnp.float32)
    plane = terrain.Plane(jnp.array([0.0, 0.0, 1.0]), jnp.zeros(3))
    for _ in range(20):  # one time constant
        plane = terrain.estimate(params, plane, footholds, period)
    remaining = np.exp(-1.0)
    np.testing.assert_allclose(plane.point_W[2], 0.3 * (1 - remaining), rtol=1e-4)
    # the normalised normal follows the exponential up to the square of the slope
    np.testing.assert_allclose(plane.normal_W[0], -0.1 * (1 - remaining), rtol=0.01)
    np.testing.assert_allclose(jnp.linalg.norm(plane.normal_W), 1.0, rtol=1e-6)


def test_control_frame_lies_on_the_ground_under_the_torso():
    rng = np.random.default_rng(1)
    torso = Rotation.from_euler("ZYX", rng.uniform(-1, 1, (100, 3)) * [3.1, 0.35, 0.35]).as_matrix()
    slope, way = rng.uniform(0, 0.4, 100), rng.uniform(-np.pi, np.pi, 100)
    normal = np.column_stack([np.sin(slope) * np.cos(way), np.sin(slope) * np.sin(way), np.cos(slope)])
    frames = jax.jit(jax.vmap(control_frame))(jnp.asarray(torso, jnp.float32), jnp.asarray(normal, jnp.float32))
    for R, R_WB, n in zip(np.asarray(frames), torso, normal):
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=ROUNDING)
        np.testing.assert_allclose(R[:, 2], n, atol=ROUNDING)
        assert abs(R[:, 1] @ R_WB[:, 0]) < ROUNDING  # the torso's x axis has no part along y of C
        assert R[:, 0] @ R_WB[:, 0] > 0
