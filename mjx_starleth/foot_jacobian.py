"""Velocities of the feet where they touch the ground, and by transposition what contact forces do to the robot."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from mjx_starleth.block_solve import apply, product, transpose
from mjx_starleth.rotation import cross
from mjx_starleth.smooth import Smooth

Array = jax.Array


class FootJacobian(NamedTuple):
    """J of the feet's points nearest to the ground, in their contact frames [t1 t2 n]."""

    base: Array  # (4, 3, 6) by the velocity of the base
    leg: Array  # (4, 3, 3) by those of the foot's own leg

    def velocity(self, u: Array) -> Array:
        """(4, 3) m/s"""
        return apply(self.base, u[None, :6]) + apply(self.leg, u[6:].reshape(4, 3))


def foot_jacobian(s: Smooth, frame: Array, r_WB: Array, radius: Array) -> FootJacobian:
    """frame (4, 3, 3): rows t1, t2, n of the ground under each foot; r_WB (3,) torso origin; foot radius, m.

    A direction d sees a rotation w about the point a as d . (w x (r - a)) = w . ((r - a) x d).
    """
    r_WP = s.r_WF - radius * frame[:, 2]
    turning = product(cross((r_WP - r_WB[None])[:, None], frame), s.R_WB[None])
    arm = cross(s.axis, r_WP[:, None] - s.anchor)
    return FootJacobian(jnp.concatenate([frame, turning], -1), product(frame, transpose(arm)))
