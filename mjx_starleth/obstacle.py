"""Distance of a foot to a board or a hole, exact: a foot that passes over an edge touches nothing.

An obstacle is a rectangle with a straight flank all around: seen from above the distance to the rectangle counts,
seen from the side the distance to its section, and because a distance grows by a metre per metre the second of the
first is the distance in space. A hole is the ground around it standing on its bottom, so that one section serves both.

A sphere in the corner between floor and flank touches both. One contact stands for the two: the path of its centre
is rounded there, and its normal turns from one to the other.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from mjx_starleth.block_solve import total

Array = jax.Array

FILLET = 0.005  # m, radius by which the centre's path is rounded in the corner; large against what a foot sinks in
FLATTEST = 0.98  # cosine between two normals, above which their corner is none
TINY = 1e-12  # m^2, keeps roots differentiable


class Nearest(NamedTuple):
    """Distance to a line in the plane of the section and the direction away from it."""

    distance: Array  # m, negative inside
    outward: Array  # component along the way out of the rectangle
    upward: Array  # component along the plane's normal


def rectangle_distance(place: Array, half_size: Array) -> tuple[Array, Array]:
    """Distance (n,) m of places (n, 2) to a rectangle, negative inside, and the direction (n, 2) out of it."""
    beyond = jnp.abs(place) - half_size[None]
    sign = jnp.where(place < 0, -1.0, 1.0)
    outside = jnp.maximum(beyond, 0.0)
    corner = jnp.sqrt(total(outside * outside) + TINY)
    x, y = beyond[:, 0], beyond[:, 1]
    inside = jnp.maximum(x, y)
    side = jnp.stack([x >= y, x < y], -1).astype(place.dtype)
    out = inside > 0
    return jnp.where(out, corner, inside), sign * jnp.where(out[:, None], outside / corner[:, None], side)


def obstacle_profile(place: Array, half_size: Array, flank: Array) -> Array:
    """Share (n,) of its height that an obstacle has at places (n, 2) in its own axes, m."""
    return jnp.clip(0.5 - rectangle_distance(place, half_size)[0] / flank, 0.0, 1.0)


def obstacle_gap(distance: Array, level: Array, radius: Array, height: Array, flank: Array) -> Nearest:
    """Gap of spheres to ground with one obstacle, in its section.

    distance (n,) of their centres to the obstacle's rectangle; level (n,) above the plane, m; height < 0 is a hole.
    """
    side = jnp.where(height < 0, -1.0, 1.0)
    level = level - jnp.minimum(height, 0.0)
    edge = _block(side * distance, level, jnp.abs(height), flank)
    met = _corner(level - radius, edge._replace(distance=edge.distance - radius))
    return met._replace(outward=side * met.outward)


def _block(distance: Array, level: Array, height: Array, flank: Array) -> Nearest:
    """To a block with a level top and a straight flank, whose middle is at distance 0."""
    length = jnp.sqrt(height * height + flank * flank)
    away, above = distance + 0.5 * flank, level - height  # of the edge between them
    slanted = (away * height + above * flank) / length
    down = away * flank - above * height
    edge = jnp.sqrt(away * away + above * above + TINY)
    on_edge, on_top = (away > 0) & (down < 0), above > slanted
    found = Nearest(jnp.maximum(above, slanted), jnp.where(on_top, 0.0, height / length), 1.0)
    found = found._replace(upward=jnp.where(on_top, 1.0, flank / length))
    corner = Nearest(edge, away / edge, above / edge)
    return Nearest(*(jnp.where(on_edge, c, f) for c, f in zip(corner, found, strict=True)))


def _corner(floor: Array, wall: Nearest) -> Nearest:
    """Gap to floor and wall together: the smaller one, but for the rounded corner between them."""
    cosine = wall.upward
    sharp = cosine < FLATTEST
    square = jnp.where(sharp, 1.0 - cosine * cosine, 1.0)
    u, v = FILLET - floor, FILLET - wall.distance
    by_floor, by_wall = (u - cosine * v) / square, (v - cosine * u) / square  # of the way from the fillet's centre
    reach = jnp.sqrt(jnp.maximum((u * u + v * v - 2.0 * cosine * u * v) / square, 0.0) + TINY)
    between = sharp & (by_floor > 0) & (by_wall > 0)
    nearer = wall.distance < floor
    return Nearest(
        distance=jnp.where(between, FILLET - reach, jnp.minimum(floor, wall.distance)),
        outward=jnp.where(between, by_wall * wall.outward / reach, jnp.where(nearer, wall.outward, 0.0)),
        upward=jnp.where(between, (by_floor + by_wall * cosine) / reach, jnp.where(nearer, cosine, 1.0)),
    )
