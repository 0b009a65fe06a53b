"""The ground: a plane of any slope, obstacles that raise it and patches that change its friction.

An obstacle adds `height * f(x) * f(y)` along the plane's normal, where f rises from 0 to 1 over `flank`: a short
flank makes a flat-topped box or step, a flank as long as the obstacle a smooth bump. The ground is thus one
height field with one normal everywhere, and a foot has one contact.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

Array = jax.Array


class Terrain(NamedTuple):
    """Ground in the world frame. K obstacles and P friction patches; their numbers are static and may be 0.

    Positions on the plane are measured from the plane's point nearest to the world's origin, along t1 (the world's x
    axis projected on the plane) and t2 = normal x t1.
    """

    normal: Array  # (3,) unit
    offset: Array  # () m, the plane is normal . r = offset
    obstacle_centre: Array  # (K, 2) m
    obstacle_half_size: Array  # (K, 2) m, to the middle of the flank
    obstacle_yaw: Array  # (K,) rad
    obstacle_height: Array  # (K,) m, may be negative
    obstacle_flank: Array  # (K,) m, horizontal length of the flank, > 0
    patch_centre: Array  # (P, 2) m
    patch_half_size: Array  # (P, 2) m
    patch_friction: Array  # (P,) friction coefficient inside the patch


class GroundContact(NamedTuple):
    """What four spherical feet see of the ground."""

    gap: Array  # (4,) distance of the sphere to the ground, negative inside, m
    normal: Array  # (4, 3) unit, out of the ground
    friction: Array  # (4,)


def plane(normal=(0.0, 0.0, 1.0), offset=0.0, obstacles: int = 0, patches: int = 0) -> Terrain:
    """A plane with room for obstacles (all of height 0) and patches (all of size 0)."""
    normal = np.asarray(normal, np.float32)
    size = np.linalg.norm(normal)
    if normal.shape != (3,) or not size > 0 or not normal[2] > 0:
        raise ValueError("The ground's normal must be three numbers that point upwards.")
    k, p = obstacles, patches
    zeros = lambda *shape: np.zeros(shape, np.float32)  # noqa: E731
    return Terrain(
        normal=normal / size,
        offset=np.float32(offset),
        obstacle_centre=zeros(k, 2),
        obstacle_half_size=zeros(k, 2) + np.float32(0.1),
        obstacle_yaw=zeros(k),
        obstacle_height=zeros(k),
        obstacle_flank=zeros(k) + np.float32(0.01),
        patch_centre=zeros(p, 2),
        patch_half_size=zeros(p, 2),
        patch_friction=zeros(p),
    )


def tangents(normal: Array) -> tuple[Array, Array]:
    """Unit vectors t1 (world x projected on the plane) and t2 = normal x t1; both (3,)."""
    ex = jnp.zeros(3, normal.dtype).at[0].set(1.0)
    t1 = ex - normal[0] * normal
    t1 = t1 / jnp.sqrt((t1 * t1).sum())
    return t1, jnp.cross(normal, t1)


def ground_contact(terrain: Terrain, r_WF: Array, radius: Array, friction: Array) -> GroundContact:
    """Gap, normal and friction under four feet with centres r_WF (4, 3) m.

    Beside an obstacle the gap is exact to first order: height above the field, times the cosine of its slope.
    """
    count = r_WF.shape[0]
    height = (r_WF * terrain.normal[None]).sum(-1) - terrain.offset
    normal = jnp.broadcast_to(terrain.normal, (count, 3))
    friction = jnp.broadcast_to(friction, (count,))
    if terrain.obstacle_height.shape[0] + terrain.patch_friction.shape[0] == 0:
        return GroundContact(height - radius, normal, friction)

    t1, t2 = tangents(terrain.normal)
    xy = jnp.stack([(r_WF * t1[None]).sum(-1), (r_WF * t2[None]).sum(-1)], -1)
    if terrain.patch_friction.shape[0]:
        off = jnp.abs(xy[:, None] - terrain.patch_centre[None]) - terrain.patch_half_size[None]
        inside = (off <= 0).all(-1)
        for k in range(inside.shape[1]):
            friction = jnp.where(inside[:, k], terrain.patch_friction[k], friction)
    if not terrain.obstacle_height.shape[0]:
        return GroundContact(height - radius, normal, friction)

    raised, slope = _obstacles(terrain, xy)
    cosine = 1 / jnp.sqrt(1 + (slope * slope).sum(-1))
    tilted = normal - slope[:, :1] * t1[None] - slope[:, 1:] * t2[None]
    return GroundContact((height - raised) * cosine - radius, tilted * cosine[:, None], friction)


def _obstacles(terrain: Terrain, xy: Array) -> tuple[Array, Array]:
    """Height added at xy (4, 2) on the plane, (4,), and its gradient (4, 2)."""
    c, s = jnp.cos(terrain.obstacle_yaw), jnp.sin(terrain.obstacle_yaw)
    d = xy[:, None] - terrain.obstacle_centre[None]
    local = jnp.stack([c * d[..., 0] + s * d[..., 1], c * d[..., 1] - s * d[..., 0]], -1)
    flank = terrain.obstacle_flank[None, :, None]
    depth = (terrain.obstacle_half_size[None] - jnp.abs(local)) / flank + 0.5
    t = jnp.clip(depth, 0, 1)
    f = t * t * (3 - 2 * t)
    df = -6 * t * (1 - t) / flank * jnp.sign(local)
    height = terrain.obstacle_height[None]
    gx, gy = height * df[..., 0] * f[..., 1], height * f[..., 0] * df[..., 1]
    gradient = jnp.stack([c * gx - s * gy, s * gx + c * gy], -1)
    return (height * f[..., 0] * f[..., 1]).sum(-1), gradient.sum(-2)
