"""mjx.step behind this package's types: a second reference. Single environments or small batches only (it calls
batched LAPACK, which can stop for ever in large ones)."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from mjx_starleth.bodies import BodyOutput, BodyParams, BodyState
from mjx_starleth.mjcf import mjcf
from mjx_starleth.names import LEGS
from mjx_starleth.numbers import RobotNumbers

Array = jax.Array

# Time constant of the contact: MuJoCo asks for at least two steps.
CONTACT_SOLREF = (6e-3, 1.0)


def mjx_step(
    numbers: RobotNumbers, params: BodyParams, period: float = 2.5e-3
) -> Callable[[BodyState, Array, Array], tuple[BodyState, BodyOutput]]:
    """`step(state, joint_torque (12,), joint_damping (12,)) -> (state, output)` by mjx.step on a plane.

    Raises ValueError for obstacles or friction patches, which MuJoCo's plane does not have.
    """
    if len(params.terrain.obstacle_height) or len(params.terrain.patch_friction):
        raise ValueError("mjx replays planes only; remove obstacles and friction patches.")
    m = mujoco.MjModel.from_xml_string(mjcf(numbers, timestep=period, solref=CONTACT_SOLREF, impratio=10.0))
    m.body_mass[1:], m.body_ipos[1:] = np.asarray(params.mass), np.asarray(params.com)
    m.body_inertia[1:] = np.asarray(params.inertia)
    m.opt.gravity[:] = np.asarray(params.gravity)
    m.pair_friction[:, :2] = np.broadcast_to(np.asarray(params.friction), (4,))[:, None]
    normal = np.asarray(params.terrain.normal, float)
    mujoco.mju_quatZ2Vec(m.geom_quat[m.geom("floor").id], normal)
    m.geom_pos[m.geom("floor").id] = normal * float(params.terrain.offset)
    m.jnt_limited[1:], m.jnt_range[1:] = 1, np.asarray(params.joint_stop)
    mujoco.mj_setConst(m, mujoco.MjData(m))
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        model, first = mjx.put_model(m), mjx.make_data(m)
    feet = np.array([m.site(f"{leg}_foot").id for leg in LEGS])
    shanks = np.array([m.site_bodyid[foot] for foot in feet])
    radius, up = float(params.foot_radius), jnp.asarray(normal, jnp.float32)

    def step(state: BodyState, torque: Array, damping: Array) -> tuple[BodyState, BodyOutput]:
        with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
            q, u = state.q, state.u
            # implicitfast takes joint damping at the new velocity: the drive's answer to the change of speed
            damped = model.replace(dof_damping=jnp.zeros(18).at[6:].set(damping))
            force = jnp.zeros(18).at[6:].set(torque + damping * u[6:])
            data = mjx.step(damped, first.replace(qpos=q, qvel=u, qfrc_applied=force))
            now = mjx.forward(damped, data)
            r_WF = now.site_xpos[feet]
            velocity = jax.vmap(lambda p, b: mjx.jac(damped, now, p, b)[0].T @ now.qvel)(
                r_WF - radius * up, jnp.asarray(shanks)
            )
            contact = _contact_forces(data, torque, r_WF)
        output = BodyOutput(
            contact_force=contact,
            contact_residual=jnp.zeros(()),
            gap=(r_WF * up[None]).sum(-1) - radius,
            r_WF=r_WF,
            v_WF=velocity,
            slip_velocity=velocity,
            joint_acceleration=(data.qvel[6:] - u[6:]) / period,
        )
        return BodyState(data.qpos, data.qvel, contact * period), output

    def _contact_forces(data, torque: Array, r_WF: Array) -> Array:
        """World forces of the ground, from what the constraints do to each leg's joints: J^T f = qfrc_constraint."""
        anchors = data.xanchor[1:].reshape(4, 3, 3)
        axes = data.xaxis[1:].reshape(4, 3, 3)
        columns = jnp.cross(axes, (r_WF - radius * up)[:, None] - anchors)
        gram = columns @ jnp.swapaxes(columns, 1, 2) + 1e-8 * jnp.eye(3)
        share = jnp.linalg.solve(gram, data.qfrc_constraint[6:].reshape(4, 3)[..., None])
        return (columns * share).sum(1)

    return step
