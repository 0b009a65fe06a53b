"""Kinematics, mass matrix and bias force of the 13 bodies, by MJX.

MJX does the tree; here its model gets the masses of the moment, and its results are cut into the blocks that
block_solve.py works on.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from mjx_starleth.mjcf import mjcf
from mjx_starleth.mjx_quiet import mjx
from mjx_starleth.names import LEGS
from mjx_starleth.numbers import RobotNumbers

Array = jax.Array


class Inertias(NamedTuple):
    """What the smooth dynamics depend on; body order: torso, then hip, thigh, shank of LF, RF, LH, RH."""

    mass: Array  # (13,) kg
    com: Array  # (13, 3) in the body's frame, m
    inertia: Array  # (13, 3) principal moments along the body's axes about its com, kg m^2
    gravity: Array  # (3,) m/s^2, world


class Smooth(NamedTuple):
    """The robot at one (q, u)."""

    m_base: Array  # (6, 6)
    cross: Array  # (4, 3, 6) leg rows, base columns
    m_leg: Array  # (4, 3, 3)
    bias: Array  # (18,) Coriolis, centrifugal and gravity forces, on the left side of the equation of motion
    R_WB: Array  # (3, 3)
    anchor: Array  # (4, 3, 3) a point on each joint's axis, world, m
    axis: Array  # (4, 3, 3) each joint's axis, world, unit
    r_WF: Array  # (4, 3) centres of the feet, world, m
    r_WC: Array  # (13, 3) centres of mass, world, m


class Tree(NamedTuple):
    """MJX's view of the robot's structure."""

    model: mjx.Model
    data: mjx.Data
    feet: tuple[int, ...]


def make_tree(numbers: RobotNumbers) -> Tree:
    """The bodies as MJX has them. No contacts and no geoms take part: the contact solver is this package's own."""
    model = mujoco.MjModel.from_xml_string(mjcf(numbers, contact=False))
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        tree = mjx.put_model(model), mjx.make_data(model)
    return Tree(*tree, tuple(model.site(f"{leg}_foot").id for leg in LEGS))


def smooth(tree: Tree, inertias: Inertias, q: Array, u: Array) -> Smooth:
    """Everything that the time step needs at position q (19,) and velocity u (18,) (MuJoCo's qpos and qvel)."""
    world = lambda x: jnp.concatenate([jnp.zeros_like(x[:1]), x])  # noqa: E731
    model = tree.model.replace(
        body_mass=world(inertias.mass),
        body_ipos=world(inertias.com),
        body_inertia=world(inertias.inertia),
        opt=tree.model.opt.replace(gravity=inertias.gravity),
    )
    data = tree.data.replace(qpos=q, qvel=u)
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        for stage in (mjx.kinematics, mjx.com_pos, mjx.crb, mjx.com_vel, mjx.rne):
            data = stage(model, data)
        m = mjx.full_m(model, data)
    return Smooth(
        m_base=m[:6, :6],
        cross=m[6:, :6].reshape(4, 3, 6),
        m_leg=jnp.stack([m[6 + 3 * i : 9 + 3 * i, 6 + 3 * i : 9 + 3 * i] for i in range(4)]),
        bias=data.qfrc_bias,
        R_WB=data.xmat[1],
        anchor=data.xanchor[1:].reshape(4, 3, 3),
        axis=data.xaxis[1:].reshape(4, 3, 3),
        r_WF=data.site_xpos[np.array(tree.feet)],
        r_WC=data.xipos[1:],
    )
