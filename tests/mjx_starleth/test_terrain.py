"""The ground against NumPy and MuJoCo: distances to its surface, normals by finite differences, friction by hand."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from mjx_starleth.obstacle import FILLET
from mjx_starleth.terrain import Terrain, ground_contact, plane, slope_normal

RADIUS, FRICTION = 0.02, 0.8
YAW, CENTRE, HALF = 0.6, np.array([0.4, -0.3]), np.array([0.2, 0.15])
BOARD, RAMP, HOLE = (0.05, 0.01), (0.04, 0.2), (-0.03, 0.05)  # height and flank, m


def ground(height: float, flank: float, slope: float = 0.0) -> Terrain:
    """One turned obstacle on a slope, and two friction patches that overlap between x = 1.5 and 2 m."""
    return plane(slope_normal(slope, 0.8), offset=0.1, obstacles=1, patches=2)._replace(
        obstacle_centre=np.float32(CENTRE[None]),
        obstacle_half_size=np.float32(HALF[None]),
        obstacle_yaw=np.float32([YAW]),
        obstacle_height=np.float32([height]),
        obstacle_flank=np.float32([flank]),
        patch_centre=np.float32([[1.5, 0.0], [2.0, 0.0]]),
        patch_half_size=np.float32([[0.5, 0.5], [0.5, 0.25]]),
        patch_friction=np.float32([0.3, 0.1]),
    )


def frame(terrain: Terrain) -> np.ndarray:
    """Columns: the plane's axes and normal in the world."""
    n = np.asarray(terrain.normal, float)
    t1 = np.array([1.0, 0, 0]) - n[0] * n
    t1 /= np.linalg.norm(t1)
    return np.column_stack([t1, np.cross(n, t1), n])


def section(height: float, flank: float) -> np.ndarray:
    """Points (n, 2) of the surface in a cut across one side: distance out of the rectangle, level over the plane."""
    line = np.array([[-0.15, height], [-flank / 2, height], [flank / 2, 0.0], [0.4, 0.0]])
    share = np.linspace(0, 1, 20001)[:, None]
    return np.concatenate([p + share * (q - p) for p, q in pairwise(line)])


def over(cut: np.ndarray) -> np.ndarray:
    """Points (n, 3) along the plane's axes of points (n, 2) in the cut through the middle of the obstacle's x side."""
    axis = np.array([np.cos(YAW), np.sin(YAW)])
    return np.column_stack([CENTRE + (HALF[0] + cut[:, :1]) * axis, cut[:, 1]])


def contact(terrain: Terrain, points: np.ndarray):
    """Of feet at points (4, 3) given along the plane's axes and normal, m above the plane."""
    r_WF = (points + np.array([0, 0, float(terrain.offset)])) @ frame(terrain).T
    seen = jax.jit(ground_contact)(terrain, jnp.asarray(r_WF, jnp.float32), jnp.float32(RADIUS), jnp.float32(FRICTION))
    return jax.tree.map(np.asarray, seen)


@pytest.mark.parametrize("slope", [0.0, 0.37])
@pytest.mark.parametrize("height, flank", [BOARD, RAMP, HOLE])
def test_gap_is_the_distance_to_the_nearest_point_of_the_surface(height, flank, slope):
    surface, top = section(height, flank), max(height, 0.0)
    out = np.array([-0.1, -flank / 2 - 0.01, -flank / 2, 0.0, flank / 4, flank / 2, 0.05, 0.25])
    cut = np.column_stack([out, [top + RADIUS + clear for clear in (1e-3, 2e-3, 5e-3, 0.03, 1e-3, 5e-3, 1e-3, 1e-3)]])
    nearest = [np.hypot(*(surface - point).T).min() for point in cut]
    terrain = ground(height, flank, slope)
    gaps = np.concatenate([contact(terrain, over(half)).gap for half in (cut[:4], cut[4:])])
    np.testing.assert_allclose(gaps + RADIUS, nearest, atol=2e-5)


def test_a_foot_that_passes_over_the_edge_of_a_board_touches_nothing():
    """A board's flank once stood as an invisible wall far above its edge, where feet swing."""
    cut = np.array([[0.005, 0.075], [0.0, 0.08], [-0.005, 0.1], [0.0, 0.17]])
    assert contact(ground(*BOARD), over(cut)).gap.min() > 0.004


@pytest.mark.parametrize("height, flank", [BOARD, RAMP, HOLE])
def test_the_normal_is_the_way_on_which_the_gap_grows(height, flank):
    low = min(height, 0.0)
    at_corner = np.array([0.5 * flank + 0.018, low + RADIUS + 0.001]) * np.array([np.sign(height), 1.0])
    cut = np.array([[-0.1, 0.1], [-0.3 * flank, max(height, 0.0) + 0.012], at_corner, [0.1, 0.1]])
    terrain, points, step = ground(height, flank, 0.2), over(cut), 1e-3
    seen = contact(terrain, points)
    ahead, behind = ([contact(terrain, points + d).gap for d in side * step * np.eye(3)] for side in (1, -1))
    slope = (np.array(ahead) - np.array(behind)) / (2 * step)
    normal = slope.T @ frame(terrain).T
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=0.02)
    np.testing.assert_allclose(seen.frame[:, 2], normal, atol=0.02)
    square = seen.frame @ seen.frame.transpose(0, 2, 1)
    np.testing.assert_allclose(square, np.broadcast_to(np.eye(3), (4, 3, 3)), atol=1e-5)


def test_boards_and_ground_are_where_mujoco_finds_them():
    """Spheres around a corner of a board in MuJoCo C: mj_geomDistance to a box and to a plane."""
    spec = mujoco.MjSpec()
    turn = [np.cos(YAW / 2), 0, 0, np.sin(YAW / 2)]
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 1], pos=[0, 0, 0.1])
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[*HALF, 0.05], pos=[*CENTRE, 0.1], quat=turn)
    ball = spec.worldbody.add_body()
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0], mass=1.0)
    model = spec.compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(3)
    local = np.column_stack([rng.uniform(0.0, 0.28, 400), rng.uniform(0.0, 0.23, 400), rng.uniform(0.02, 0.12, 400)])
    inside = (local < [*HALF, 0.05]).all(1)
    local[inside, 2] += 0.05
    axis = np.array([[np.cos(YAW), -np.sin(YAW)], [np.sin(YAW), np.cos(YAW)]])
    points = np.column_stack([CENTRE + local[:, :2] @ axis.T, local[:, 2]])
    found = np.concatenate([contact(ground(0.05, 1e-5), four).gap for four in points.reshape(-1, 4, 3)])
    for point, gap in zip(points, found, strict=True):
        data.qpos[:3] = point + np.array([0, 0, 0.1])
        mujoco.mj_kinematics(model, data)
        both = [mujoco.mj_geomDistance(model, data, other, 2, 1.0, None) for other in (0, 1)]
        assert gap == pytest.approx(min(both), abs=1e-4 if min(both) > FILLET or max(both) > FILLET else 0.42 * FILLET)


def test_an_obstacle_without_height_is_no_obstacle():
    cut = np.array([[0.0, 0.02], [0.001, 0.019], [-0.02, 0.03], [0.02, 0.0195]])
    seen = contact(ground(0.0, 0.01, 0.3), over(cut))
    np.testing.assert_allclose(seen.gap, cut[:, 1] - RADIUS, atol=1e-6)
    np.testing.assert_allclose(seen.frame[:, 2], np.broadcast_to(slope_normal(0.3, 0.8), (4, 3)), atol=1e-6)


def test_friction_is_that_of_the_later_patch_under_the_foot():
    points = np.array([[0.5, 0.2, 0.02], [1.2, 0.4, 0.02], [1.8, 0.1, 0.02], [2.4, 0.3, 0.02]])
    np.testing.assert_allclose(contact(ground(*BOARD), points).friction, [FRICTION, 0.3, 0.1, FRICTION])
