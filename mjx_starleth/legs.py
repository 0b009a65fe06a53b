"""Kinematics, mass matrix and bias force written out for a torso with four equal three-joint legs.

The same equations as smooth.py, without a general tree: all links of all legs at once, a quarter of the time and of
the compile time. Spatial vectors are about the torso's origin and in the torso's axes, in an inertial frame that
moves with that origin, where the base's linear velocity drops out of the bias force. Composite rigid bodies for the
mass matrix, Newton-Euler for the bias (Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 5 and 6).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mjx_starleth.block_solve import apply, product, total, transpose
from mjx_starleth.names import FORE_SIGN, LEFT_SIGN
from mjx_starleth.numbers import RobotNumbers
from mjx_starleth.rotation import cross, rotate, rotation_matrix
from mjx_starleth.smooth import Inertias, Smooth

Array = jax.Array
EYE = np.eye(3, dtype=np.float32)


class LegGeometry(NamedTuple):
    """Where the joints are; links hang along -z at zero angles, HAA turns about x, HFE and KFE about y."""

    hip: np.ndarray  # (4, 3) HAA axes in the torso, m
    length: np.ndarray  # (3,) hip, thigh, shank to the next joint or the foot's centre, m


class Chain(NamedTuple):
    """The twelve links in torso axes, link-major (3, 4, ...)."""

    rotation: Array  # (3, 4, 3, 3)
    anchor: Array  # (3, 4, 3) joint before the link
    axis: Array  # (3, 4, 3)
    foot: Array  # (4, 3)


def leg_geometry(numbers: RobotNumbers) -> LegGeometry:
    b = numbers.bodies
    hip = [
        (fore * b.haa_in_torso.x, left * b.haa_in_torso.y, b.haa_in_torso.z)
        for fore, left in zip(FORE_SIGN, LEFT_SIGN, strict=True)
    ]
    return LegGeometry(np.float32(hip), np.float32([b.hip.length, b.thigh.length, b.foot.centre_from_knee]))


def lowest_foot(geometry: LegGeometry, joints: Array) -> Array:
    """How far the lowest foot's centre is below the origin of a level torso, m; joints (12,)."""
    return -_chain(geometry, joints.reshape(4, 3).T).foot[:, 2].min()


def smooth_legs(geometry: LegGeometry, inertias: Inertias, q: Array, u: Array) -> Smooth:
    """Everything that the time step needs at position q (19,) and velocity u (18,); see smooth.py."""
    R_WB = rotation_matrix(q[3:7])
    chain = _chain(geometry, q[7:].reshape(4, 3).T)
    links = lambda x: x[1:].reshape(4, 3, *x.shape[1:]).swapaxes(0, 1)  # noqa: E731
    mass, com = links(inertias.mass)[..., None], links(inertias.com)
    r_BC = chain.anchor + apply(chain.rotation, com)
    body = _about_origin(mass, r_BC, chain.rotation, links(inertias.inertia))
    torso = _about_origin(inertias.mass[:1], inertias.com[0], jnp.asarray(EYE), inertias.inertia[0])

    lever = cross(chain.anchor, chain.axis)  # linear part of each joint's motion
    rate = u[6:].reshape(4, 3).T[..., None]
    gravity = apply(transpose(R_WB), inertias.gravity)
    F, N = _up(_link_forces(body, chain.axis * rate, lever * rate, u[3:6], gravity))
    base_F, base_N = _force(torso, u[3:6], jnp.zeros_like(gravity), jnp.zeros_like(gravity), -gravity)

    composite = _up(body)
    f = composite.mass * lever + cross(chain.axis, composite.moment)
    n = apply(composite.inertia, chain.axis) + cross(composite.moment, lever)
    whole = jax.tree.map(lambda own, legs: own + total(legs[0], 0), torso, composite)
    forward = product(R_WB, -_skew(whole.moment))
    m_base = [[whole.mass[:, None] * EYE, forward], [transpose(forward), whole.inertia]]
    to_world = lambda x: rotate(R_WB, x)  # noqa: E731
    place = lambda x: to_world(x) + q[:3].reshape((1,) * (x.ndim - 1) + (3,))  # noqa: E731

    bias_leg = total(chain.axis * N) + total(lever * F)
    return Smooth(
        m_base=jnp.concatenate([jnp.concatenate(row, 1) for row in m_base], 0),
        cross=jnp.concatenate([to_world(f), n], -1).swapaxes(0, 1),
        m_leg=_leg_blocks(chain.axis, lever, f, n),
        bias=jnp.concatenate([to_world(base_F + total(F[0], 0)), base_N + total(N[0], 0), bias_leg.T.reshape(12)]),
        R_WB=R_WB,
        anchor=place(chain.anchor).swapaxes(0, 1),
        axis=to_world(chain.axis).swapaxes(0, 1),
        r_WF=place(chain.foot),
        r_WC=place(jnp.concatenate([inertias.com[:1], r_BC.swapaxes(0, 1).reshape(12, 3)])),
    )


class SpatialInertia(NamedTuple):
    """Inertia about the torso's origin; leading axes are bodies."""

    mass: Array  # (..., 1)
    moment: Array  # (..., 3) mass times position
    inertia: Array  # (..., 3, 3)


def _about_origin(mass: Array, r: Array, rotation: Array, principal: Array) -> SpatialInertia:
    moment = mass * r
    own = product(rotation * principal[..., None, :], transpose(rotation))
    shift = total(moment * r)[..., None, None] * jnp.broadcast_to(EYE, own.shape)
    return SpatialInertia(mass, moment, own + shift - moment[..., :, None] * r[..., None, :])


def _chain(geometry: LegGeometry, angle: Array) -> Chain:
    """angle (3, 4): HAA, HFE, KFE of each leg."""
    pitch = jnp.stack([jnp.zeros_like(angle[0]), angle[1], angle[1] + angle[2]])
    c, s = jnp.cos(pitch), jnp.sin(pitch)
    ch, sh = jnp.broadcast_to(jnp.cos(angle[0]), c.shape), jnp.broadcast_to(jnp.sin(angle[0]), c.shape)
    zero = jnp.zeros_like(c)
    x, y = jnp.stack([c, sh * s, -ch * s], -1), jnp.stack([zero, ch, sh], -1)
    z = jnp.stack([s, -sh * c, ch * c], -1)
    reach = -geometry.length[:, None, None] * z
    knee = geometry.hip + reach[0]
    anchor = jnp.stack([jnp.asarray(geometry.hip), knee, knee + reach[1]])
    roll = jnp.broadcast_to(np.float32([1, 0, 0]), (4, 3))
    return Chain(jnp.stack([x, y, z], -1), anchor, jnp.stack([roll, y[0], y[0]]), anchor[2] + reach[2])


def _link_forces(body: SpatialInertia, turn: Array, slide: Array, omega: Array, gravity: Array):
    """Force and moment (3, 4, 3) that carry each link through the bias motion; turn, slide: joint axis times rate."""
    W, V = _down(turn) + omega[None, None], _down(slide)
    aW, aV = _down(cross(W, turn)), _down(cross(W, slide) + cross(V, turn)) - gravity[None, None]
    return _force(body, W, V, aW, aV)


def _force(body: SpatialInertia, W: Array, V: Array, aW: Array, aV: Array) -> tuple[Array, Array]:
    momentum = body.mass * V + cross(W, body.moment)
    spin = apply(body.inertia, W) + cross(body.moment, V)
    force = body.mass * aV + cross(aW, body.moment) + cross(W, momentum)
    return force, apply(body.inertia, aW) + cross(body.moment, aV) + cross(W, spin) + cross(V, momentum)


def _leg_blocks(axis: Array, lever: Array, f: Array, n: Array) -> Array:
    """(4, 3, 3) from the composite bodies' response f, n to each joint; only ancestors of a joint see it."""
    entry = lambda i, j: total(axis[i] * n[j]) + total(lever[i] * f[j])  # noqa: E731
    m00, m01, m02, m11, m12, m22 = (entry(i, j) for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    return jnp.stack([m00, m01, m02, m01, m11, m12, m02, m12, m22], -1).reshape(4, 3, 3)


def _down(x: Array) -> Array:
    """Sums from the torso outwards over the links (3, ...)."""
    second = x[0] + x[1]
    return jnp.stack([x[0], second, second + x[2]])


def _up(tree):
    """Sums from the foot inwards over the links (3, ...), of every array in a pytree."""

    def one(x):
        second = x[1] + x[2]
        return jnp.stack([x[0] + second, second, x[2]])

    return jax.tree.map(one, tree)


def _skew(v: Array) -> Array:
    x, y, z = v[0], v[1], v[2]
    zero = jnp.zeros_like(x)
    return jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
