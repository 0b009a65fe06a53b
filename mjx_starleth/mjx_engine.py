"""`mjx.step` behind the bodies' interface: MJX's own integrator and contact, for checks.

For small batches only: vmapped over 256 environments on two cores, MJX's batched LAPACK calls have been seen to
wait for each other for ever.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from mjx_starleth.block_solve import apply, total, transpose
from mjx_starleth.body_types import BodyInput, BodyOutput, BodyParams, BodyState, nominal_params
from mjx_starleth.mjx_quiet import mjx
from mjx_starleth.mujoco_model import mujoco_model
from mjx_starleth.names import LEGS
from mjx_starleth.numbers import RobotNumbers
from mjx_starleth.rotation import cross
from mjx_starleth.terrain import ground_contact

Array = jax.Array

SOFT_IMPRATIO = 10.0
SOFT_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)  # MuJoCo's own
SOFT_TIME = 6e-3  # s


@dataclass(frozen=True, eq=False)
class MjxEngine:
    """The robot in MJX; restitution, terrain and foot radius are those it was made with."""

    params: BodyParams
    period: float  # s
    substeps: int
    model: mjx.Model
    data: mjx.Data
    feet: np.ndarray  # (4,) sites

    def step(self, params: BodyParams, state: BodyState, input: BodyInput) -> tuple[BodyState, BodyOutput]:
        """One period; pure. Masses, gravity, friction and joint stops are taken from `params`."""
        damping = jnp.zeros(12) if input.joint_damping is None else input.joint_damping
        held = input.joint_torque + damping * state.u[6:]
        force = jnp.zeros(18) if input.generalised_force is None else input.generalised_force
        force = force.at[6:].add(held)

        def substep(data, _):
            stop, stop_damping = _joint_stops(params, data.qpos[7:], data.qvel[6:])
            applied = force.at[6:].add(stop)
            if input.wrench_W is not None:
                turned = apply(transpose(data.xmat[1]), input.wrench_W[3:])
                applied = applied.at[:6].add(jnp.concatenate([input.wrench_W[:3], turned]))
            model = _with_params(self.model, params, damping + stop_damping)
            with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
                data = mjx.step(model, data.replace(qfrc_applied=applied))
            return data, data.qfrc_constraint

        with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
            data = mjx.kinematics(self.model, self.data.replace(qpos=state.q, qvel=state.u))
        data, pushed = jax.lax.scan(substep, data, None, length=self.substeps)
        return self._result(params, state, data, pushed.sum(0) / self.substeps)

    def _result(self, params, state: BodyState, data: mjx.Data, pushed: Array) -> tuple[BodyState, BodyOutput]:
        q, u = data.qpos, data.qvel
        with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
            data = mjx.kinematics(self.model, data)
        r_WF = data.site_xpos[self.feet]
        ground = ground_contact(params.terrain, r_WF, params.foot_radius, params.friction)
        n, R_WB = ground.frame[:, 2], data.xmat[1]
        anchor, axis = data.xanchor[1:].reshape(4, 3, 3), data.xaxis[1:].reshape(4, 3, 3)

        joint_rate = u[6:].reshape(4, 3, 1)
        omega_B = apply(R_WB, u[3:6])[None]
        v_WF = u[None, :3] + cross(jnp.broadcast_to(omega_B, (4, 3)), r_WF - q[None, :3])
        v_WF = v_WF + total(cross(axis, r_WF[:, None] - anchor) * joint_rate, 1)
        turning = omega_B + total(axis * joint_rate, 1)
        # the joints of a leg feel nothing but the force on its foot: tau = J^T f
        arms = cross(axis, (r_WF - params.foot_radius * n)[:, None] - anchor)
        contact_force = _solve3(arms, pushed[6:].reshape(4, 3))
        output = BodyOutput(
            contact_force=contact_force,
            contact_residual=jnp.zeros((), jnp.float32),  # MJX's laws are its own
            gap=ground.gap,
            r_WF=r_WF,
            v_WF=v_WF,
            slip_velocity=v_WF - cross(turning, params.foot_radius * n),
            joint_acceleration=(u[6:] - state.u[6:]) / self.period,
        )
        return BodyState(q, u, contact_force * self.period), output


def make_mjx_engine(
    numbers: RobotNumbers, params: BodyParams | None = None, period: float = 2.5e-3, substeps: int = 1
) -> MjxEngine:
    """The robot on the ground of `params` (nominal, level). Raises ValueError for obstacles, patches or compliance."""
    params = nominal_params(numbers) if params is None else params
    if np.any(np.asarray(params.terrain.obstacle_height)) or params.terrain.patch_friction.shape[0]:
        raise ValueError("The MJX engine knows planes only; use MuJoCo C for obstacles and friction patches.")
    model = mujoco_model(numbers, params, period / substeps)
    # single precision: MJX's solver loses a nearly rigid contact, where MuJoCo C in double precision does not
    model.opt.impratio, model.pair_solimp[:] = SOFT_IMPRATIO, SOFT_SOLIMP
    model.pair_solref[:, 0] = np.maximum(model.pair_solref[:, 0], SOFT_TIME)
    feet = np.array([model.site(f"{leg}_foot").id for leg in LEGS])
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        return MjxEngine(params, period, substeps, mjx.put_model(model), mjx.make_data(model), feet)


def _with_params(model: mjx.Model, params: BodyParams, joint_damping: Array) -> mjx.Model:
    world = lambda x: jnp.concatenate([jnp.zeros_like(x[:1]), x])  # noqa: E731
    return model.replace(
        body_mass=world(params.mass),
        body_ipos=world(params.com),
        body_inertia=world(params.inertia),
        opt=model.opt.replace(gravity=jnp.asarray(params.gravity)),
        pair_friction=jnp.asarray(model.pair_friction).at[:, :2].set(params.friction),
        dof_damping=jnp.concatenate([jnp.zeros(6), joint_damping]),
    )


def _joint_stops(params: BodyParams, q: Array, u: Array) -> tuple[Array, Array]:
    low, high = params.joint_stop[:, 0], params.joint_stop[:, 1]
    spring = params.stop_stiffness * (jnp.maximum(low - q, 0) + jnp.minimum(high - q, 0))
    pressing = spring * (spring - params.stop_damping * u) > 0
    return jnp.where(pressing, spring, 0), jnp.where(pressing, params.stop_damping, 0)


def _solve3(rows: Array, b: Array) -> Array:
    """x of rows (..., 3, 3) x = b (..., 3), by Cramer's rule; zero where singular: no axial force of a straight leg."""
    r0, r1, r2 = rows[..., 0, :], rows[..., 1, :], rows[..., 2, :]
    c0, c1, c2 = cross(r1, r2), cross(r2, r0), cross(r0, r1)
    determinant = total(r0 * c0)
    x = b[..., :1] * c0 + b[..., 1:2] * c1 + b[..., 2:] * c2
    return x / jnp.where(jnp.abs(determinant) > 1e-9, determinant, jnp.inf)[..., None]
