"""Bodies and contact fed with the measured joint torques: what force and torque is left unexplained?

With measured motion and measured joint torque, eq. 1 of the paper needs no integration:

    M(q) du/dt + bias(q, u) - S^T tau = J^T lambda + residual.

A foot in the air has lambda = 0, so its leg's three equations are residuals. A foot on the ground has the lambda
that its leg's three equations demand, and the six equations of the torso are residuals. On a clamped torso all
twelve joint equations are residuals. They are evaluated on raw rows and smoothed afterwards: being nearly linear in
acceleration and torque, they lose sensor noise in the filter but nothing of what a controlled motion does.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import savgol_filter

from experiments.effects.compose import ActiveEffects, EffectNumbers
from experiments.lanes import lanes
from experiments.measurement.evidence.behind_sensors import behind_sensors
from experiments.measurement.evidence.unlogged import measured_or
from experiments.measurement.logs.log import Log
from mjx_starleth.bodies import Bodies, BodyParams, make_bodies
from mjx_starleth.numbers import RobotNumbers
from mjx_starleth.smooth import Smooth
from sea_jax import JointMotion
from sea_jax.hooks import no_signals

Array = jax.Array

SMOOTHING = 0.05  # s, half width of the filter on the residuals
LEAST_NORMAL = 5.0  # N by which a foot's tangential force is divided at least
STRAIGHT = 1e-10  # m^6, square of a leg's determinant below which its inverse is damped
LANES = 32  # rows that go through the equations together: more of them leave the fastest cache
DECIMATION = 4  # rows per residual kept: the filter leaves no more than that


class BodyLog(NamedTuple):
    """Measurements on T rows; float32, SI."""

    q: np.ndarray  # (T, 19) r_WB, quaternion, joints
    u: np.ndarray  # (T, 18)
    du: np.ndarray  # (T, 18) time derivative of u, central differences
    torque: np.ndarray  # (T, 12) joint torque as the sensor showed it
    contact: np.ndarray  # (T, 4) 1 on the ground, 0 in the air


class BodyResidual(NamedTuple):
    """What the bodies' equations of motion leave, row by row."""

    torso: Array  # (T, 6) force (world) and torque (torso frame) on the torso, N and N m
    joints: Array  # (T, 12) torque on the joints of legs in the air (all, if the torso is clamped), N m
    foot_force: Array  # (T, 4, 3) force of the ground on each foot, world frame, N
    gap: Array  # (T, 4) distance of the feet to the ground, m
    slip_velocity: Array  # (T, 4) sliding speed of the feet, m/s
    friction: Array  # (T, 4) tangential over normal force, less the model's friction coefficient


@dataclass(frozen=True, eq=False)
class BodyReplay:
    """Inverse dynamics of the whole robot with a set of effects."""

    bodies: Bodies
    effects: ActiveEffects
    clamped: bool  # torso fixed to the world

    def residual(self, log: BodyLog, numbers: EffectNumbers) -> BodyResidual:
        """The residuals of every row, T a multiple of LANES, with the effects' numbers."""
        log = self._true(log, numbers)
        shared = (self.effects.apply("body_parameters", numbers, self.bodies.params), numbers)
        run = lanes(lambda shared, row: self._row(*shared, row))
        parts = jax.tree.map(lambda table: table.reshape(-1, LANES, *table.shape[1:]), log)
        found = jax.lax.map(lambda rows: run(shared, rows), parts)
        return jax.tree.map(lambda table: table.reshape(-1, *table.shape[2:]), found)

    def _row(self, params: BodyParams, numbers: EffectNumbers, row: BodyLog) -> BodyResidual:
        s = self.bodies.smooth(params, row.q, row.u)
        on_torso, on_legs = self._needed(s, row.du, numbers)
        n = params.terrain.normal[None]
        touching = s.r_WF - params.foot_radius * n
        arm = touching - row.q[None, :3]
        leg_jacobian = jnp.cross(s.axis, touching[:, None] - s.anchor)  # (4 legs, 3 joints, 3 world)
        on_ground = row.contact * (0.0 if self.clamped else 1.0)
        # a bearing's drag is next to nothing of the load that it is in proportion to
        carried = on_ground[:, None] * solve3(leg_jacobian, on_legs - row.torque.reshape(4, 3))
        tau = row.torque - self._drag(row.u, _radial_load(params, s.axis, carried), numbers)
        on_legs = on_legs - tau.reshape(4, 3)
        foot_force = on_ground[:, None] * solve3(leg_jacobian, on_legs)
        on_torso = on_torso - jnp.concatenate([foot_force.sum(0), mv(s.R_WB.T, jnp.cross(arm, foot_force).sum(0))])
        normal = (foot_force * n).sum(-1)
        velocity = _foot_velocity(s.R_WB, row.u, arm, leg_jacobian)
        give = params.compliance * (normal + params.ground_damping * (velocity * n).sum(-1))
        friction = jnp.broadcast_to(params.friction, (4,))
        return BodyResidual(
            torso=on_torso,
            joints=(on_legs * (1.0 - on_ground[:, None])).reshape(12),
            foot_force=foot_force,
            gap=(touching * n).sum(-1) - params.terrain.offset + give,
            slip_velocity=_size_along(velocity, n),
            friction=_size_along(foot_force, n) / jnp.maximum(normal, LEAST_NORMAL) - friction,
        )

    def _needed(self, s: Smooth, du: Array, numbers: EffectNumbers) -> tuple[Array, Array]:
        """What has to act on the torso (6,) and on the legs' joints (4, 3) for this motion, feet and drives aside."""
        base, legs = du[:6], du[6:].reshape(4, 3)
        pull = self.effects.apply("torso_force", numbers, jnp.zeros(3, jnp.float32))
        force = jnp.concatenate([pull, jnp.zeros(3, jnp.float32)])
        on_torso = mv(s.m_base, base) + mv(s.cross.swapaxes(1, 2), legs).sum(0) + s.bias[:6] - force
        return on_torso, mv(s.cross, base[None]) + mv(s.m_leg, legs) + s.bias[6:].reshape(4, 3)

    def _true(self, log: BodyLog, numbers: EffectNumbers) -> BodyLog:
        """The log without what the effects do to the joints' sensors."""
        motion = JointMotion(log.q[:, 7:], log.u[:, 6:], log.du[:, 6:], jnp.zeros_like(log.torque))
        motion, torque = behind_sensors(self.effects, numbers, motion, log.torque, self.bodies.period)
        q = jnp.concatenate([log.q[:, :7], motion.position], 1)
        u = jnp.concatenate([log.u[:, :6], motion.velocity], 1)
        du = jnp.concatenate([log.du[:, :6], motion.acceleration], 1)
        return log._replace(q=q, u=u, du=du, torque=torque)

    def _drag(self, u: Array, load: Array, numbers: EffectNumbers) -> Array:
        zero = jnp.zeros(12, jnp.float32)
        signals = no_signals(zero, self.bodies.period)._replace(joint_velocity=u[6:], radial_load=load)
        return self.effects.apply("joint_drag", numbers, zero, signals)


def _foot_velocity(R_WB: Array, u: Array, arm: Array, leg_jacobian: Array) -> Array:
    """Velocity of the feet's contact points (4, 3) in the world, their arms (4, 3) taken from the torso."""
    omega = jnp.broadcast_to(mv(R_WB, u[3:6])[None], arm.shape)
    return u[None, :3] + jnp.cross(omega, arm) + (leg_jacobian * u[6:].reshape(4, 3, 1)).sum(1)


def _size_along(vectors: Array, n: Array) -> Array:
    """Size of the parts of vectors (4, 3) along a plane with normal n (1, 3); with a slope at zero, too."""
    along = vectors - (vectors * n).sum(-1)[:, None] * n
    return jnp.sqrt((along * along).sum(-1) + 1e-12)


def _radial_load(params: BodyParams, axis: Array, foot_force: Array) -> Array:
    """Force across each joint's axis (12,), N: the foot's force less the weight below, inertia left out."""
    below = jnp.cumsum(params.mass[1:].reshape(4, 3)[:, ::-1], 1)[:, ::-1]
    force = foot_force[:, None] + below[..., None] * params.gravity[None, None]
    across = force - (force * axis).sum(-1, keepdims=True) * axis
    return jnp.sqrt((across * across).sum(-1) + 1e-6).reshape(12)


@lru_cache(maxsize=8)
def body_replay(numbers: RobotNumbers, effects: ActiveEffects, clamped: bool) -> BodyReplay:
    """The replay for a robot; logs of one robot get the same one, and so share its compiled program."""
    return BodyReplay(make_bodies(numbers, dynamics="legs"), effects, clamped)


def body_log(log: Log) -> BodyLog:
    """The bodies' part of a log on the robot."""
    q_joint, torque = log.joints("joint_position"), log.joints("joint_torque")
    v_joint = measured_or(np.gradient(q_joint, log.sample_period, axis=0), log.joints("joint_velocity"))
    base_q, base_u = _base_motion(log)
    q = np.nan_to_num(np.concatenate([base_q, q_joint], 1))
    u = np.nan_to_num(np.concatenate([base_u, v_joint], 1))
    contact = np.zeros((log.rows, 4)) if log.experiment == "fixed_base" else np.nan_to_num(log.vector("foot_contact"))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    # the central difference spans a row on both sides: so does the torque that caused it
    torque = convolve1d(np.nan_to_num(torque), [0.25, 0.5, 0.25], axis=0, mode="nearest")
    tables = (q, u, np.gradient(u, log.sample_period, axis=0), torque, contact)
    return BodyLog(*(np.asarray(table, np.float32) for table in tables))


def filter_window(period: float) -> int:
    """Rows of the residuals' filter (odd)."""
    return 2 * round(SMOOTHING / period) + 1


def thinned(rows: np.ndarray, period: float) -> np.ndarray:
    """Smoothed residuals on every DECIMATION-th row, without the ends that the filter cannot reach."""
    window = filter_window(period)
    smooth_rows = savgol_filter(rows, window, 2, axis=0)
    return smooth_rows[window // 2 : len(rows) - window // 2 : DECIMATION]


def settled(contact: np.ndarray, period: float) -> np.ndarray:
    """(N, 4) True where a foot's contact did not change within the filter's reach, on the rows of `thinned`."""
    window = filter_window(period)
    share = savgol_filter(contact, window, 0, axis=0)[window // 2 : len(contact) - window // 2 : DECIMATION]
    return np.abs(share - 0.5) > 0.499


def shows_bodies(log: Log) -> bool:
    """Whether a log tells how the bodies move and what moves them, at every joint: of a torso on the ground, where it
    is and which feet stand as well."""
    tables = [log.joints(name) for name in ("joint_position", "joint_torque")]
    if log.experiment != "fixed_base":
        tables += [log.vector(name) for name in ("base_position", "base_orientation", "foot_contact")]
    return all(table is not None and np.isfinite(table).any(0).all() for table in tables)


def _base_motion(log: Log) -> tuple[np.ndarray, np.ndarray]:
    if log.experiment == "fixed_base":
        return np.tile([0.0, 0, 0, 1, 0, 0, 0], (log.rows, 1)), np.zeros((log.rows, 6))
    position, orientation = log.vector("base_position"), log.vector("base_orientation")
    linear, angular = log.vector("base_linear_velocity"), log.vector("base_angular_velocity")
    linear = measured_or(np.gradient(position, log.sample_period, axis=0), linear)
    angular = measured_or(_turning(orientation, log.sample_period), angular)
    return np.concatenate([position, orientation], 1), np.concatenate([linear, angular], 1)


def _turning(orientation: np.ndarray, period: float) -> np.ndarray:
    """Angular velocity in the torso's frame (T, 3) of its orientation (T, 4): twice the conjugate times its rate."""
    w, v = orientation[:, :1], orientation[:, 1:]
    rate = np.gradient(orientation, period, axis=0)
    return 2.0 * (w * rate[:, 1:] - v * rate[:, :1] - np.cross(v, rate[:, 1:]))


def mv(a: Array, v: Array) -> Array:
    """Matrix times vector (..., i, j) (..., j), fused."""
    return (a * v[..., None, :]).sum(-1)


def solve3(a: Array, b: Array) -> Array:
    """Solve a x = b for (..., 3, 3) and (..., 3) by Cramer's rule, damped where a leg is straight."""
    r0, r1, r2 = a[..., 0, :], a[..., 1, :], a[..., 2, :]
    c12, c20, c01 = jnp.cross(r1, r2), jnp.cross(r2, r0), jnp.cross(r0, r1)
    determinant = (r0 * c12).sum(-1)
    inverse = determinant / (determinant * determinant + STRAIGHT)
    return (b[..., 0:1] * c12 + b[..., 1:2] * c20 + b[..., 2:3] * c01) * inverse[..., None]
