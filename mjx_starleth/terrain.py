"""The ground: a plane of any slope, obstacles that raise it and patches that change its friction.

An obstacle is a block along the plane's normal with straight flanks: a short one makes a flat-topped board or step,
one as long as the obstacle a ramp up and down. A foot has one contact: that with the nearest point of the ground.
Of obstacles that overlap the higher one counts.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mjx_starleth.block_solve import total
from mjx_starleth.obstacle import obstacle_gap, rectangle_distance
from mjx_starleth.rotation import cross

Array = jax.Array


class Terrain(NamedTuple):
    """Ground in the world frame. K obstacles and P friction patches; their numbers are static and may be 0.

    Places on the plane are measured from its point nearest to the world's origin, along t1 (the world's x axis
    projected on the plane) and t2 = normal x t1.
    """

    normal: Array  # (3,) unit
    offset: Array  # () m, the plane is normal . r = offset
    obstacle_centre: Array  # (K, 2) m
    obstacle_half_size: Array  # (K, 2) from the centre to the middle of the flank, m
    obstacle_yaw: Array  # (K,) rad
    obstacle_height: Array  # (K,) m, negative is a hole
    obstacle_flank: Array  # (K,) horizontal length of the flank, m
    patch_centre: Array  # (P, 2) m
    patch_half_size: Array  # (P, 2) m
    patch_friction: Array  # (P,) friction coefficient inside the patch; of two patches the later one counts


class GroundContact(NamedTuple):
    """What four spherical feet see of the ground."""

    gap: Array  # (4,) distance of the sphere to the ground, negative inside, m
    frame: Array  # (4, 3, 3) rows t1, t2, n: unit, n out of the ground, world frame
    friction: Array  # (4,)


def plane(
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0), offset: float = 0.0, obstacles: int = 0, patches: int = 0
) -> Terrain:
    """A plane with room for obstacles (of height 0) and patches (of size 0).

    Raises ValueError if the normal does not point upwards.
    """
    n = np.asarray(normal, float)
    if n.shape != (3,) or not np.isfinite(n).all() or not n[2] > 0:
        raise ValueError("The ground's normal must be three numbers that point upwards.")
    return Terrain(
        normal=np.float32(n / np.linalg.norm(n)),
        offset=np.float32(offset),
        obstacle_centre=np.zeros((obstacles, 2), np.float32),
        obstacle_half_size=np.full((obstacles, 2), 0.1, np.float32),
        obstacle_yaw=np.zeros(obstacles, np.float32),
        obstacle_height=np.zeros(obstacles, np.float32),
        obstacle_flank=np.full(obstacles, 0.01, np.float32),
        patch_centre=np.zeros((patches, 2), np.float32),
        patch_half_size=np.zeros((patches, 2), np.float32),
        patch_friction=np.zeros(patches, np.float32),
    )


def slope_normal(angle: float, direction: float = 0.0) -> tuple[float, float, float]:
    """Normal of a plane that falls by `angle` towards `direction` (from the world's x axis about z), rad."""
    return (np.sin(angle) * np.cos(direction), np.sin(angle) * np.sin(direction), np.cos(angle))


def contact_frame(normal: Array) -> Array:
    """Rows t1, t2, n (..., 3, 3) of unit normals (..., 3): t1 is the world's x axis projected on the surface."""
    along = jnp.broadcast_to(np.float32([1, 0, 0]), normal.shape) - normal[..., :1] * normal
    t1 = along * jax.lax.rsqrt(total(along * along))[..., None]
    return jnp.stack([t1, cross(normal, t1), normal], -2)


def ground_contact(terrain: Terrain, r_WF: Array, radius: Array, friction: Array) -> GroundContact:
    """Gap, contact frame and friction under feet with centres r_WF (4, 3) m.

    The gap is the distance to the ground's nearest point (obstacle.py), so that an edge is where it is and no higher.
    """
    feet = r_WF.shape[0]
    level = contact_frame(terrain.normal)
    height = total(r_WF * terrain.normal[None]) - terrain.offset
    friction = jnp.broadcast_to(friction, (feet,))
    if not terrain.patch_friction.shape[0] and not terrain.obstacle_height.shape[0]:
        return GroundContact(height - radius, jnp.broadcast_to(level, (feet, 3, 3)), friction)

    place = total(r_WF[:, None] * level[None, :2])
    for k in range(terrain.patch_friction.shape[0]):
        away = jnp.abs(place - terrain.patch_centre[k][None]) - terrain.patch_half_size[k][None]
        friction = jnp.where(away.max(-1) <= 0, terrain.patch_friction[k], friction)

    gap, normal = height - radius, jnp.broadcast_to(terrain.normal, (feet, 3))
    for k in range(terrain.obstacle_height.shape[0]):
        near, away = _obstacle(terrain, k, place, height, radius, level)
        counts = jnp.abs(near - (height - radius)) > jnp.abs(gap - (height - radius))
        gap, normal = jnp.where(counts, near, gap), jnp.where(counts[:, None], away, normal)
    return GroundContact(gap, contact_frame(normal), friction)


def _obstacle(
    terrain: Terrain, k: int, place: Array, height: Array, radius: Array, level: Array
) -> tuple[Array, Array]:
    """Gap (4,) and normal (4, 3) of feet at places (4, 2) on the plane and heights (4,) over it: obstacle k alone."""
    c, s = jnp.cos(terrain.obstacle_yaw[k]), jnp.sin(terrain.obstacle_yaw[k])
    d = place - terrain.obstacle_centre[k][None]
    local = jnp.stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0]], -1)
    distance, out = rectangle_distance(local, terrain.obstacle_half_size[k])
    near = obstacle_gap(distance, height, radius, terrain.obstacle_height[k], terrain.obstacle_flank[k])
    out = jnp.stack([c * out[:, 0] - s * out[:, 1], s * out[:, 0] + c * out[:, 1]], -1)
    out_W = total(out[:, :, None] * level[None, :2], 1)
    return near.distance, near.outward[:, None] * out_W + near.upward[:, None] * terrain.normal[None]
