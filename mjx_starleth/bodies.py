"""The rigid bodies in time: Moreau's midpoint step with hard contacts (paper II, eq. 1).

q_M = q + h/2 u                              M, bias and J at q_M; contacts with gap(q_M) <= 0 are closed
M (u' - u) = h (tau - bias) + J^T impulse    set-valued laws between J u' and the impulse (contact.py)
q' = q_M + h/2 u'
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from mjx_starleth.block_solve import (
    Factor,
    apply,
    back_substitute,
    factor,
    forward_substitute,
    product,
    total,
    transpose,
)
from mjx_starleth.body_types import (
    BodyInput,
    BodyOutput,
    BodyParams,
    BodyState,
    nominal_params,
    nominal_stance,
)
from mjx_starleth.contact import SWEEPS, ContactProblem, solve_contacts
from mjx_starleth.foot_jacobian import FootJacobian, foot_jacobian
from mjx_starleth.legs import LegGeometry, leg_geometry, lowest_foot, smooth_legs
from mjx_starleth.numbers import RobotNumbers
from mjx_starleth.rotation import cross, integrate
from mjx_starleth.smooth import Inertias, Smooth, Tree, make_tree, smooth
from mjx_starleth.terrain import GroundContact, ground_contact

__all__ = ["Bodies", "BodyInput", "BodyOutput", "BodyParams", "BodyState", "make_bodies"]

Array = jax.Array


@dataclass(frozen=True, eq=False)
class Bodies:
    """The robot's bodies: structure here, numbers in `params`, which are the nominal ones on a level plane."""

    params: BodyParams
    period: float  # s
    sweeps: int  # of the contact solver in each step
    tree: Tree
    smooth_dynamics: Callable[[Inertias, Array, Array], Smooth]
    geometry: LegGeometry
    stance: np.ndarray  # (19,)
    contacts: Callable[[ContactProblem, Array, int], tuple[Array, Array]] = solve_contacts  # the contact laws

    def initial_state(self, joint_position: Array | None = None, base_height: Array | None = None) -> BodyState:
        """At rest, level, over the world's origin: the default stance unless joints (12,) or height (m) differ.

        Joints without a height put the lowest foot on the ground at height 0.
        """
        q = jnp.asarray(self.stance)
        if joint_position is not None:
            q = q.at[7:].set(jnp.asarray(joint_position, jnp.float32))
            q = q.at[2].set(lowest_foot(self.geometry, q[7:]) + self.params.foot_radius)
        if base_height is not None:
            q = q.at[2].set(jnp.asarray(base_height, jnp.float32))
        return BodyState(q, jnp.zeros(18, jnp.float32), jnp.zeros((4, 3), jnp.float32))

    def smooth(self, params: BodyParams, q: Array, u: Array) -> Smooth:
        """Kinematics, mass matrix and bias force at (q, u)."""
        return self.smooth_dynamics(Inertias(params.mass, params.com, params.inertia, params.gravity), q, u)

    def step(self, params: BodyParams, state: BodyState, input: BodyInput) -> tuple[BodyState, BodyOutput]:
        """One period; pure."""
        h, u = self.period, state.u
        q_mid = integrate(state.q, u, h / 2)
        s = self.smooth(params, q_mid, u)
        ground = ground_contact(params.terrain, s.r_WF, params.foot_radius, params.friction)

        force, damping = _applied(params, input, s.R_WB, q_mid, u, h)
        f = factor(s.m_base, s.cross, s.m_leg + h * damping.reshape(4, 3, 1) * np.eye(3, dtype=np.float32)[None])
        push = h * (force - s.bias)
        push_leg = push[6:].reshape(4, 3)
        push_base = forward_substitute(f.lower, push[:6] - total(apply(transpose(f.gain), push_leg), 0))

        jacobian = foot_jacobian(s, ground.frame, q_mid[:3], params.foot_radius)
        problem = _contact_problem(params, ground, f, jacobian, u, push_base, push_leg, h)
        impulse, residual = self.contacts(problem, apply(ground.frame, state.impulse), self.sweeps)

        du_base = back_substitute(f.lower, push_base + total(apply(problem.root, impulse), 0))
        du_leg = apply(f.leg_inverse, push_leg + apply(transpose(jacobian.leg), impulse))
        du_leg = (du_leg - apply(f.gain, du_base[None])).reshape(12)
        u_new = u + jnp.concatenate([du_base, du_leg])

        impulse = apply(transpose(ground.frame), impulse)
        output = _output(params, s, ground, jacobian, u_new, impulse, residual, du_leg, h)
        return BodyState(integrate(q_mid, u_new, h / 2), u_new, impulse), output

    def energy(self, params: BodyParams, state: BodyState) -> tuple[Array, Array]:
        """Kinetic and potential energy, J; the potential is zero with all masses at the world's origin."""
        s = self.smooth(params, state.q, state.u)
        base, leg = state.u[:6], state.u[6:].reshape(4, 3)
        momentum = apply(s.m_base, base) + 2 * total(apply(transpose(s.cross), leg), 0)
        kinetic = 0.5 * (total(base * momentum) + (leg * apply(s.m_leg, leg)).sum())
        return kinetic, -(params.mass[:, None] * s.r_WC * params.gravity[None]).sum()


def make_bodies(
    numbers: RobotNumbers,
    period: float = 2.5e-3,
    sweeps: int = SWEEPS,
    dynamics: Literal["mjx", "legs"] = "mjx",
) -> Bodies:
    """The nominal robot on a level plane.

    dynamics: who computes kinematics, mass matrix and bias force: MJX, or legs.py, the same written out for this
    robot (equal to rounding, several times cheaper to run and to compile). Raises ValueError for another name.
    """
    tree, geometry = make_tree(numbers), leg_geometry(numbers)
    compute = {"mjx": partial(smooth, tree), "legs": partial(smooth_legs, geometry)}
    if dynamics not in compute:
        raise ValueError(f"No dynamics '{dynamics}'; choose one of {', '.join(compute)}.")
    return Bodies(nominal_params(numbers), period, sweeps, tree, compute[dynamics], geometry, nominal_stance(numbers))


def _applied(params: BodyParams, input: BodyInput, R_WB: Array, q: Array, u: Array, h: float) -> tuple[Array, Array]:
    """Generalised force (18,) at the old velocities, and the damping (12,) by which the joints' new ones lower it.

    A joint stop is a one-sided spring and damper. Evaluated at the end of the step, k (d - h u') - c u' with the
    penetration d at q_M, it is stable however stiff it is. It never pulls.
    """
    joint, rate = q[7:], u[6:]
    low, high = params.joint_stop[:, 0], params.joint_stop[:, 1]
    spring = params.stop_stiffness * (jnp.maximum(low - joint, 0) + jnp.minimum(high - joint, 0))
    pressing = spring * (spring - params.stop_damping * rate) > 0
    damping = jnp.where(pressing, h * params.stop_stiffness + params.stop_damping, 0)
    torque = input.joint_torque + jnp.where(pressing, spring, 0) - damping * rate
    if input.joint_damping is not None:
        damping = damping + input.joint_damping

    base = jnp.zeros(6, torque.dtype)
    if input.wrench_W is not None:
        base = jnp.concatenate([input.wrench_W[:3], apply(transpose(R_WB), input.wrench_W[3:])])
    force = jnp.concatenate([base, torque])
    return force if input.generalised_force is None else force + input.generalised_force, damping


def _contact_problem(
    params: BodyParams,
    ground: GroundContact,
    f: Factor,
    jacobian: FootJacobian,
    u: Array,
    push_base: Array,
    push_leg: Array,
    h: float,
) -> ContactProblem:
    """A compliant ground is a spring and a damper on the gap at the step's end:

    gap + h v_n + compliance (damping v_n + force) >= 0.
    """
    root = forward_substitute(f.lower, (jacobian.base - product(jacobian.leg, f.gain)).transpose(2, 0, 1))
    root = root.transpose(1, 0, 2)
    leg = product(jacobian.leg, f.leg_inverse)
    old = jacobian.velocity(u)
    free = old + apply(transpose(root), push_base[None]) + apply(leg, push_leg)

    soft = params.compliance > 0
    lag = h + params.compliance * params.ground_damping
    target = jnp.where(soft, ground.gap / lag, params.restitution * old[:, 2])
    closed = jnp.where(soft, 1.0, (ground.gap <= 0).astype(jnp.float32))
    normal = np.float32([0, 0, 1])
    give = params.compliance / (h * lag) * np.diag(normal)
    return ContactProblem(
        root=root,
        own=product(leg, transpose(jacobian.leg)) + give[None],
        free_velocity=free + target[:, None] * normal[None],
        friction=ground.friction,
        closed=closed,
    )


def _output(
    params: BodyParams,
    s: Smooth,
    ground: GroundContact,
    jacobian: FootJacobian,
    u: Array,
    impulse: Array,
    residual: Array,
    du_leg: Array,
    h: float,
) -> BodyOutput:
    n = ground.frame[:, 2]
    local = jacobian.velocity(u)
    slip = apply(transpose(ground.frame), local)
    omega_W = apply(s.R_WB, u[3:6])[None] + total(s.axis * u[6:].reshape(4, 3, 1), 1)
    v_WF = slip + cross(omega_W, params.foot_radius * n)
    return BodyOutput(
        contact_force=impulse / h,
        contact_residual=residual / h,
        gap=ground.gap + h / 2 * local[:, 2],
        r_WF=s.r_WF + h / 2 * v_WF,
        v_WF=v_WF,
        slip_velocity=slip,
        joint_acceleration=du_leg / h,
    )
