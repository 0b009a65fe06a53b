"""The ground against NumPy: distances searched on its surface, normals by finite differences, friction by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from mjx_starleth.terrain import Terrain, ground_contact, plane, slope_normal

RADIUS, FRICTION = 0.02, 0.8
YAW, CENTRE, HALF = 0.6, np.array([0.4, -0.3]), np.array([0.2, 0.15])
BOARD, BUMP, HOLE = (0.05, 0.01), (0.04, 0.3), (-0.03, 0.05)  # height and flank, m


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


def raised(height: float, flank: float, place: np.ndarray) -> float:
    """What the obstacle adds over a place of the plane, from its description."""
    c, s = np.cos(YAW), np.sin(YAW)
    local = np.array([[c, s], [-s, c]]) @ (place - CENTRE)
    t = np.clip((HALF - np.abs(local)) / flank + 0.5, 0, 1)
    return height * np.prod(t * t * (3 - 2 * t))


def contact(terrain: Terrain, points: np.ndarray):
    """Of feet at points (4, 3) given along the plane's axes and normal, m above the plane."""
    r_WF = (points + np.array([0, 0, float(terrain.offset)])) @ frame(terrain).T
    seen = jax.jit(ground_contact)(terrain, jnp.asarray(r_WF, jnp.float32), jnp.float32(RADIUS), jnp.float32(FRICTION))
    return jax.tree.map(np.asarray, seen)


@pytest.mark.parametrize("slope", [0.0, 0.37])
@pytest.mark.parametrize("height, flank", [BOARD, BUMP, HOLE])
def test_gap_is_the_distance_to_the_surface_beside_on_and_over_the_flank_of_an_obstacle(height, flank, slope):
    terrain = ground(height, flank, slope)
    c, s = np.cos(YAW), np.sin(YAW)
    out = np.array([c, s])  # along the obstacle's own x axis
    places = CENTRE + np.array([0.0, HALF[0], HALF[0] + 0.2 * flank, HALF[0] + flank])[:, None] * out
    points = np.column_stack([places, [raised(height, flank, p) + RADIUS + 0.001 for p in places]])
    gap = contact(terrain, points).gap
    for point, found in zip(points, gap, strict=True):
        distance = lambda p, r=point: np.hypot(np.linalg.norm(p - r[:2]), raised(height, flank, p) - r[2])  # noqa: E731
        nearest = min(minimize(distance, point[:2] + d, method="Nelder-Mead").fun for d in 0.01 * np.eye(2))
        # to first order in the curvature: under a foot of 2 cm a flank of 1 cm bends within the foot
        assert found + RADIUS == pytest.approx(nearest, abs=1e-5 if flank > 0.1 else 0.012)
    top, beside = gap[0], gap[3]
    assert (top, beside) == pytest.approx((0.001, 0.001), abs=1e-5), "where the ground is flat it is exact"


@pytest.mark.parametrize("height, flank", [BUMP, HOLE])
def test_normal_is_that_of_the_height_field(height, flank):
    terrain = ground(height, flank, 0.2)
    offsets = np.array([[0.05, 0.0], [HALF[0], 0.02], [HALF[0] - 0.02, HALF[1]], [-HALF[0], -HALF[1] + 0.01]])
    places = CENTRE + offsets @ np.array([[np.cos(YAW), np.sin(YAW)], [-np.sin(YAW), np.cos(YAW)]])
    seen = contact(terrain, np.column_stack([places, np.full(4, 0.1)]))
    step = 1e-5
    for place, axes in zip(places, seen.frame, strict=True):
        slope = [
            (raised(height, flank, place + d) - raised(height, flank, place - d)) / (2 * step) for d in step * np.eye(2)
        ]
        normal = np.array([-slope[0], -slope[1], 1.0])
        np.testing.assert_allclose(axes[2], frame(terrain) @ normal / np.linalg.norm(normal), atol=1e-4)
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-5)


def test_friction_is_that_of_the_later_patch_under_the_foot():
    points = np.array([[0.5, 0.2, 0.02], [1.2, 0.4, 0.02], [1.8, 0.1, 0.02], [2.4, 0.3, 0.02]])
    np.testing.assert_allclose(contact(ground(*BOARD), points).friction, [FRICTION, 0.3, 0.1, FRICTION])
