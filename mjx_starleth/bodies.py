"""The rigid bodies in time: Moreau's midpoint step with hard contacts (paper II, eq. 1).

q_M = q + h/2 u;   M, bias, J at q_M;   contacts with gap(q_M) <= 0 are closed
M (u' - u) = h (tau - bias) + J^T impulse,  set-valued laws between J u' and the impulse
q' = q_M + h/2 u'
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mjx_starleth.block_solve import apply, back_substitute, factor, forward_substitute, product, transpose
from mjx_starleth.contact import ContactProblem, solve_contacts
from mjx_starleth.names import JOINT_SIGN, JOINTS, LEGS
from mjx_starleth.numbers import RobotNumbers
from mjx_starleth.smooth import Inertias, Tree, make_tree, smooth
from mjx_starleth.terrain import Terrain, ground_contact, plane

Array = jax.Array

# No value is published. As stiff as the drive's own knee stop, and enough damping not to bounce.
STOP_STIFFNESS = 300.0
STOP_DAMPING = 2.0


class BodyParams(NamedTuple):
    """Everything about bodies and ground that may be searched, perturbed or fitted; float32, SI.

    Bodies: torso, then hip, thigh and shank of LF, RF, LH, RH.
    """

    mass: Array  # (13,) kg
    com: Array  # (13, 3) in the body's frame, m
    inertia: Array  # (13, 3) principal, along the body's axes about its com, kg m^2
    gravity: Array  # (3,) m/s^2
    foot_radius: Array  # () m
    terrain: Terrain
    friction: Array  # () between foot and ground, outside of patches
    restitution: Array  # () Newton's, normal
    compliance: Array  # () of the ground under one foot, m/N; 0 is exactly hard
    joint_stop: Array  # (12, 2) rad
    stop_stiffness: Array  # () N m/rad
    stop_damping: Array  # () N m s/rad


class BodyState(NamedTuple):
    """What the scan carries."""

    q: Array  # (19,) r_WB, quaternion torso to world (w x y z), joints
    u: Array  # (18,) v_WB in the world frame, omega_B in the torso frame, joint velocities
    impulse: (
        Array  # (4, 3) contact impulses of the last step in the world frame, N s: the solver's first guess
    )


class BodyInput(NamedTuple):
    """What acts on the bodies during one period; None is zero."""

    joint_torque: Array  # (12,) N m
    joint_damping: Array | None = (
        None  # (12,) >= 0, N m s/rad: minus the derivative of that torque by joint velocity
    )
    wrench_W: Array | None = None  # (6,) force N and torque N m on the torso's origin, world frame
    generalised_force: Array | None = None  # (18,) dual to u


class BodyOutput(NamedTuple):
    """What happened in one period. Feet are at its end."""

    contact_force: Array  # (4, 3) world frame, mean over the period, N
    contact_residual: Array  # () largest violation of the contact laws, N
    gap: Array  # (4,) m
    r_WF: Array  # (4, 3) centres of the feet, m
    v_WF: Array  # (4, 3) velocities of the feet's centres, m/s
    slip_velocity: Array  # (4, 3) velocity of the foot's point nearest to the ground, m/s
    joint_acceleration: Array  # (12,) mean over the period, rad/s^2


@dataclass(frozen=True, eq=False)
class Bodies:
    """The robot's bodies on their ground: structure here, numbers in `params`."""

    params: BodyParams
    period: float
    tree: Tree
    stance: np.ndarray  # (19,)
    sweeps: int

    def initial_state(self, joint_position=None, base_height=None) -> BodyState:
        """At rest, level, over the world's origin; the default stance unless joints (12,) or height say otherwise."""
        q = jnp.asarray(self.stance)
        if joint_position is not None:
            q = q.at[7:].set(jnp.asarray(joint_position, jnp.float32))
        if base_height is not None:
            q = q.at[2].set(jnp.asarray(base_height, jnp.float32))
        return BodyState(q, jnp.zeros(18, jnp.float32), jnp.zeros((4, 3), jnp.float32))

    def step(self, params: BodyParams, state: BodyState, input: BodyInput) -> tuple[BodyState, BodyOutput]:
        """One period of Moreau's scheme; pure."""
        h, u = self.period, state.u
        q_mid = integrate(state.q, u, h / 2)
        s = smooth(self.tree, _inertias(params), q_mid, u)
        ground = ground_contact(params.terrain, s.r_WF, params.foot_radius, params.friction)

        force, damping = _applied(params, input, s.R_WB, q_mid, u, h)
        f = factor(
            s.m_base, s.cross, s.m_leg + h * damping.reshape(4, 3, 1) * np.eye(3, dtype=np.float32)[None]
        )
        base, leg = h * (force - s.bias)[:6], h * (force - s.bias)[6:].reshape(4, 3)
        rest = forward_substitute(f.lower, base - apply(transpose(f.gain), leg).sum(0))

        # Jacobians of the points of the feet nearest to the ground, per foot (3, 6) and (3, 3)
        touching = s.r_WF - params.foot_radius * ground.normal
        arm = touching - state_position(q_mid)[None]
        j_base = jnp.concatenate(
            [jnp.broadcast_to(np.eye(3, dtype=np.float32), (4, 3, 3)), -product(skew(arm), s.R_WB[None])], -1
        )
        j_leg = transpose(jnp.cross(s.axis, touching[:, None] - s.anchor))

        root = forward_substitute(f.lower, transpose(j_base - product(j_leg, f.gain)).swapaxes(0, 1))
        root = root.swapaxes(0, 1)
        own = product(j_leg, f.leg_inverse)
        old = apply(j_base, u[None, :6]) + apply(j_leg, u[6:].reshape(4, 3))
        free = old + apply(transpose(root), rest[None]) + apply(own, leg)

        # restitution acts on closing velocities; a compliant ground is an implicit spring on the gap
        n = ground.normal
        bounce = params.restitution * (old * n).sum(-1)
        soft = params.compliance > 0
        target = jnp.where(soft, ground.gap / h, bounce)
        closed = jnp.where(soft, 1.0, (ground.gap <= 0).astype(jnp.float32))
        give = params.compliance / h**2 * n[:, :, None] * n[:, None, :]
        problem = ContactProblem(
            root,
            product(own, transpose(j_leg)) + give,
            free + target[:, None] * n,
            n,
            ground.friction,
            closed,
        )
        impulse, residual = solve_contacts(problem, state.impulse, self.sweeps)

        du_base = back_substitute(f.lower, rest + apply(root, impulse).sum(0))
        pushed = leg + apply(transpose(j_leg), impulse)
        du_leg = apply(f.leg_inverse, pushed) - apply(f.gain, du_base[None])
        u_new = u + jnp.concatenate([du_base, du_leg.reshape(12)])

        slip = apply(j_base, u_new[None, :6]) + apply(j_leg, u_new[6:].reshape(4, 3))
        omega = apply(s.R_WB, u_new[3:6])[None] + (s.axis * u_new[6:].reshape(4, 3, 1)).sum(1)
        v_WF = slip + jnp.cross(omega, params.foot_radius * n)
        output = BodyOutput(
            contact_force=impulse / h,
            contact_residual=residual / h,
            gap=ground.gap + h / 2 * (v_WF * n).sum(-1),
            r_WF=s.r_WF + h / 2 * v_WF,
            v_WF=v_WF,
            slip_velocity=slip,
            joint_acceleration=du_leg.reshape(12) / h,
        )
        return BodyState(integrate(q_mid, u_new, h / 2), u_new, impulse), output

    def energy(self, params: BodyParams, state: BodyState) -> tuple[Array, Array]:
        """Kinetic and potential energy, J; the potential is zero with all masses at the world's origin."""
        s = smooth(self.tree, _inertias(params), state.q, state.u)
        base, leg = state.u[:6], state.u[6:].reshape(4, 3)
        momentum = apply(s.m_base, base) + 2 * apply(transpose(s.cross), leg).sum(0)
        kinetic = 0.5 * ((base * momentum).sum() + (leg * apply(s.m_leg, leg)).sum())
        return kinetic, -(params.mass[:, None] * s.r_WC * params.gravity[None]).sum()


def make_bodies(numbers: RobotNumbers, period: float = 2.5e-3, sweeps: int = 15) -> Bodies:
    """The nominal robot on a level plane. sweeps: of the contact solver in each step."""
    return Bodies(nominal_params(numbers), period, make_tree(numbers), _stance(numbers), sweeps)


def nominal_params(numbers: RobotNumbers) -> BodyParams:
    b = numbers.bodies
    bodies = (b.torso, *(b.hip, b.thigh, b.shank) * len(LEGS))
    limits = [getattr(numbers.joint_limits_LF, joint) for joint in JOINTS] * len(LEGS)
    stops = [sorted(sign * limit for limit in pair) for sign, pair in zip(JOINT_SIGN, limits, strict=True)]
    array = lambda x: np.asarray(x, np.float32)  # noqa: E731
    return BodyParams(
        mass=array([body.mass for body in bodies]),
        com=array([body.com for body in bodies]),
        inertia=array([body.inertia_diagonal for body in bodies]),
        gravity=array([0, 0, -numbers.gravity]),
        foot_radius=array(b.foot.radius),
        terrain=plane(),
        friction=array(numbers.contact.friction),
        restitution=array(numbers.contact.restitution),
        compliance=array(0),
        joint_stop=array(stops),
        stop_stiffness=array(STOP_STIFFNESS),
        stop_damping=array(STOP_DAMPING),
    )


def integrate(q: Array, u: Array, period: float) -> Array:
    """q moved with u for a time; the orientation by the exact rotation about a fixed axis in the torso."""
    angle = period * u[3:6]
    size = jnp.sqrt((angle * angle).sum() + 1e-20)
    w, x, y, z = q[3], q[4], q[5], q[6]
    c, (a, b, d) = jnp.cos(size / 2), angle * (jnp.sin(size / 2) / size)
    turned = jnp.stack(
        [
            w * c - x * a - y * b - z * d,
            w * a + x * c + y * d - z * b,
            w * b - x * d + y * c + z * a,
            w * d + x * b - y * a + z * c,
        ]
    )
    turned = turned * jax.lax.rsqrt((turned * turned).sum())
    return jnp.concatenate([q[:3] + period * u[:3], turned, q[7:] + period * u[6:]])


def skew(v: Array) -> Array:
    """Cross-product matrices (..., 3, 3) of vectors (..., 3)."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    o = jnp.zeros_like(x)
    return jnp.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(*v.shape, 3)


def state_position(q: Array) -> Array:
    return q[:3]


def _stance(numbers: RobotNumbers) -> np.ndarray:
    pose = numbers.default_stance.LF
    angles = np.array([pose.HAA, pose.HFE, pose.KFE] * 4) * np.array(JOINT_SIGN)
    return np.concatenate([[0, 0, numbers.default_stance.base_height, 1, 0, 0, 0], angles]).astype(np.float32)


def _inertias(params: BodyParams) -> Inertias:
    return Inertias(params.mass, params.com, params.inertia, params.gravity)


def _applied(
    params: BodyParams, input: BodyInput, R_WB: Array, q: Array, u: Array, h: float
) -> tuple[Array, Array]:
    """Generalised force (18,) and the damping (12,) by which it falls with the joints' new velocities.

    A joint stop is a one-sided spring and damper, evaluated at the end of the step and linearised:
    k (d - h u') - c u' with the penetration d at q_M, which no stiffness makes unstable. It never pulls.
    """
    low, high = params.joint_stop[:, 0] - q[7:], params.joint_stop[:, 1] - q[7:]
    penetration = jnp.maximum(low, 0) + jnp.minimum(high, 0)
    push = params.stop_stiffness * penetration
    pressing = push * (push - params.stop_damping * u[6:]) > 0
    stop_damping = jnp.where(pressing, h * params.stop_stiffness + params.stop_damping, 0)
    joint = input.joint_torque + jnp.where(pressing, push, 0) - stop_damping * u[6:]
    damping = stop_damping if input.joint_damping is None else stop_damping + input.joint_damping
    base = jnp.zeros(6, joint.dtype)
    if input.wrench_W is not None:
        base = jnp.concatenate([input.wrench_W[:3], apply(transpose(R_WB), input.wrench_W[3:])])
    force = jnp.concatenate([base, joint])
    if input.generalised_force is not None:
        force = force + input.generalised_force
    return force, damping
