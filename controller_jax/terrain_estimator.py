"""The ground as a plane through the last foothold of each leg (III.B, FACTS 3.4).

Least squares of z = d - a x - b y over four points. About their mean the constant drops out and two normal
equations in a, b remain.
"""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.rotations import normalize
from controller_jax.types import Array

SMALLEST_SPREAD = 1e-6  # m^4, determinant of the normal equations: four footholds in one line read as level


class Plane(NamedTuple):
    """Ground plane in the world."""

    normal_W: Array  # (3,) unit, upwards
    point_W: Array  # (3,) a point of the plane, m


class TerrainParams(NamedTuple):
    """How fast the estimate follows new footholds."""

    time_constant: Array  # () s


def fit_plane(footholds_W: Array) -> Plane:
    """Plane with the least squared vertical distance to the footholds (4, 3), through their mean."""
    mean = footholds_W.mean(0)
    x, y, z = jnp.moveaxis(footholds_W - mean[None], -1, 0)
    xx, xy, yy = (x * x).sum(), (x * y).sum(), (y * y).sum()
    xz, yz = (x * z).sum(), (y * z).sum()
    determinant = jnp.maximum(xx * yy - xy * xy, SMALLEST_SPREAD)
    a = (yz * xy - xz * yy) / determinant
    b = (xz * xy - yz * xx) / determinant
    return Plane(normalize(jnp.stack([a, b, jnp.ones_like(a)])), mean)


def estimate(params: TerrainParams, plane: Plane, footholds_W: Array, period: Array) -> Plane:
    """Plane one control period (s) later: first-order filter on the normal and the point."""
    fit = fit_plane(footholds_W)
    share = 1.0 - jnp.exp(-period / params.time_constant)
    normal = normalize(plane.normal_W + share * (fit.normal_W - plane.normal_W))
    return Plane(normal, plane.point_W + share * (fit.point_W - plane.point_W))


def height_at(plane: Plane, r_W: Array) -> Array:
    """World z of the plane under or over the points r_W (..., 3), m."""
    normal = plane.normal_W
    d = r_W - plane.point_W.reshape((1,) * (r_W.ndim - 1) + (3,))
    return plane.point_W[2] - (normal[0] * d[..., 0] + normal[1] * d[..., 1]) / normal[2]
