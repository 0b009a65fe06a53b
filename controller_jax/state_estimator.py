"""Extended Kalman filter of the torso (III.A): predicted by the IMU, corrected by feet that stand still.

State: orientation, velocity, gyro and accelerometer bias; the position is their integral and drifts, which the
terrain estimate takes up because the footholds drift along. The errors are taken so that the velocity of a
standing foot measures them linearly and turning the world about gravity changes nothing (invariant EKF,
DOI 10.1177/0278364919894385), which keeps the filter consistent in yaw:

    R = Exp(theta) R^,   v = Exp(theta) v^ + rho,   gyro bias = b^_g + d_g,   accelerometer bias = b^_a + d_a
    theta' = -R d_g,     rho' = g x theta - R d_a - v x (R d_g)
    innovation of a standing foot: -(v^ + R^ w^) = rho + R [r]x d_g,     w = omega x r + J qd

A foot whose innovation is improbable slips and is left out. The others, equally trusted, split into two 3 x 3
updates: their mean sees velocity, their differences see the gyro bias. Both together equal a joint update.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from controller_jax.foot_contact import soles
from controller_jax.leg_kinematics import leg_kinematics
from controller_jax.rotations import cross, mm, mtv, mv, skew
from controller_jax.small_linalg import inverse3
from controller_jax.types import Array, LegGeometry, RobotState

TINY = 1e-12  # rad^2, angle squared below which a turn is no turn


class EstimatorParams(NamedTuple):
    """Noise of the sensors as the filter takes it; standard deviations, every field () unless said."""

    gyro: Array  # rad/s, white, per sample
    accelerometer: Array  # m/s^2, white, per sample
    gyro_bias_walk: Array  # rad/s per sqrt(s)
    accelerometer_bias_walk: Array  # m/s^2 per sqrt(s)
    foot_velocity: Array  # m/s, of a foot that stands
    outlier: Array  # squared Mahalanobis distance (3 degrees of freedom) beyond which a foot slips
    initial: Array  # (4,) orientation rad, velocity m/s, gyro bias rad/s, accelerometer bias m/s^2


class SensorReading(NamedTuple):
    """What the robot senses in one control period."""

    gyro_B: Array  # (3,) rad/s
    specific_force_B: Array  # (3,) acceleration minus gravity, mean over the last period, m/s^2
    q: Array  # (12,) rad
    qd: Array  # (12,) rad/s
    contact: Array  # (4,) 1.0 where the foot is on the ground


class EstimatorState(NamedTuple):
    """What the scan carries."""

    r_WB: Array  # (3,) m
    R_WB: Array  # (3, 3)
    v_WB: Array  # (3,) m/s
    gyro_bias: Array  # (3,) rad/s
    accelerometer_bias: Array  # (3,) m/s^2
    covariance: Array  # (12, 12) of theta, rho, d_g, d_a


class EstimatorInfo(NamedTuple):
    """How well the standing feet agree with the estimate."""

    distance: Array  # (4,) squared Mahalanobis distance of each foot's velocity from the prediction
    used: Array  # (4,) 1.0 where the foot corrected the estimate


def init(params: EstimatorParams, r_WB: Array, R_WB: Array, v_WB: Array) -> EstimatorState:
    """Estimate at a known pose and velocity, uncertain by `params.initial`."""
    variance = jnp.repeat(params.initial**2, 3)
    zero = jnp.zeros(3, r_WB.dtype)
    return EstimatorState(r_WB, R_WB, v_WB, zero, zero, jnp.eye(12, dtype=r_WB.dtype) * variance[None])


def step(
    params: EstimatorParams, geometry: LegGeometry, state: EstimatorState, reading: SensorReading, period: Array
) -> tuple[EstimatorState, RobotState, EstimatorInfo]:
    """One control period (s): predict to now, correct with the feet in contact."""
    state = predict(params, state, reading, geometry.gravity, period)
    up = jnp.array([0.0, 0.0, 1.0], jnp.float32)
    feet = soles(geometry, leg_kinematics(geometry, reading.q), reading.q, reading.qd, state.R_WB, up)
    state, info = correct(params, state, reading, feet.r_BS_B, feet.v_BS_B)
    robot = RobotState(
        r_WB=state.r_WB,
        R_WB=state.R_WB,
        v_WB=state.v_WB,
        omega_B=reading.gyro_B - state.gyro_bias,
        q=reading.q,
        qd=reading.qd,
        contact=reading.contact,
    )
    return state, robot, info


def predict(
    params: EstimatorParams, state: EstimatorState, reading: SensorReading, gravity: Array, period: Array
) -> EstimatorState:
    """Strap-down integration over one period and growth of the covariance."""
    turn = period * (reading.gyro_B - state.gyro_bias)
    R = orthonormal(mm(state.R_WB, rotation_exp(turn)))
    fall = jnp.array([0.0, 0.0, -1.0], jnp.float32) * gravity
    v = state.v_WB + period * (mv(R, reading.specific_force_B - state.accelerometer_bias) + fall)
    r = state.r_WB + 0.5 * period * (state.v_WB + v)
    P = _transition(_transition(state.covariance, R, v, fall, period).T, R, v, fall, period)
    return state._replace(r_WB=r, R_WB=R, v_WB=v, covariance=P + _process_noise(params, v, period))


def _transition(P: Array, R: Array, v: Array, fall: Array, period: Array) -> Array:
    """F P with F = I + period * A, where only theta and rho have rates."""
    theta, d_g, d_a = P[:3], P[6:9], P[9:]
    by_gyro = -period * mm(R, d_g)  # (3, 12)
    by_accelerometer = -period * mm(R, d_a)
    rho = P[3:6] + period * mm(skew(fall), theta) + by_accelerometer + mm(skew(v), by_gyro)
    return jnp.concatenate([theta + by_gyro, rho, d_g, d_a])


def _process_noise(params: EstimatorParams, v: Array, period: Array) -> Array:
    """Covariance added in one period; isotropic in the torso, so that R drops out."""
    gyro, accelerometer = (params.gyro * period) ** 2, (params.accelerometer * period) ** 2
    one, zero, V = np.eye(3, dtype=np.float32), np.zeros((3, 3), np.float32), skew(v)
    VV = mm(V, V)
    walk_g, walk_a = params.gyro_bias_walk**2 * period, params.accelerometer_bias_walk**2 * period
    rows = (
        (gyro * one, -gyro * V, zero, zero),
        (gyro * V, accelerometer * one - gyro * VV, zero, zero),
        (zero, zero, walk_g * one, zero),
        (zero, zero, zero, walk_a * one),
    )
    return jnp.concatenate([jnp.concatenate(row, 1) for row in rows])


def correct(
    params: EstimatorParams, state: EstimatorState, reading: SensorReading, r_BS_B: Array, v_BS_B: Array
) -> tuple[EstimatorState, EstimatorInfo]:
    """Update with the velocities of the feet in contact; r, v (4, 3) of the soles seen from the torso, in B."""
    omega = jnp.broadcast_to(reading.gyro_B - state.gyro_bias, (4, 3))
    seen_B = cross(omega, r_BS_B) + v_BS_B
    innovation = -(state.v_WB[None] + mv(state.R_WB[None], seen_B))
    P, variance = state.covariance, params.foot_velocity**2
    one = jnp.eye(3, dtype=P.dtype)

    # the gyro bias's part in the innovation, under 1 cm/s, is left out of the gate
    distance = (innovation * mv(inverse3(P[3:6, 3:6] + variance * one)[None], innovation)).sum(-1)
    used = jnp.where(distance < params.outlier, reading.contact, 0.0)
    count = used.sum()
    share = used / jnp.maximum(count, 1.0)

    # the feet's mean: rho + R [r]x d_g
    r_mean = (share[:, None] * r_BS_B).sum(0)
    y, B = (share[:, None] * innovation).sum(0), mm(state.R_WB, skew(r_mean))
    PH = P[:, 3:6] + mm(P[:, 6:9], B.T)  # (12, 3)
    weight = jnp.minimum(count, 1.0) * inverse3(PH[3:6] + mm(B, PH[6:9]) + (variance / jnp.maximum(count, 1.0)) * one)
    gain = mm(PH, weight)
    error, P = mv(gain, y), P - mm(gain, PH.T)

    # their differences: R [r - r_mean]x d_g, in information form because one or two feet leave it singular
    arm = r_BS_B - r_mean[None]
    used_arm = used[:, None] * arm
    information = (used_arm * arm).sum() * one - (used_arm[:, :, None] * arm[:, None, :]).sum(0)
    moment = -cross(used_arm, mtv(state.R_WB[None], innovation)).sum(0) - mv(information, error[6:9])
    Pg = P[:, 6:9]
    gain = mm(Pg, inverse3(variance * one + mm(information, Pg[6:9])))
    error, P = error + mv(gain, moment), P - mm(gain, mm(information, Pg.T))

    turn = rotation_exp(error[:3])
    state = EstimatorState(
        r_WB=state.r_WB,
        R_WB=mm(turn, state.R_WB),
        v_WB=mv(turn, state.v_WB) + error[3:6],
        gyro_bias=state.gyro_bias + error[6:9],
        accelerometer_bias=state.accelerometer_bias + error[9:],
        covariance=0.5 * (P + P.T),
    )
    return state, EstimatorInfo(distance, used)


def rotation_exp(turn: Array) -> Array:
    """Rotation matrix of a rotation vector (3,), rad."""
    square = (turn * turn).sum() + TINY
    angle = jnp.sqrt(square)
    K = skew(turn)
    return (
        jnp.eye(3, dtype=turn.dtype)
        + (jnp.sin(angle) / angle) * K
        + (0.5 * (jnp.sin(0.5 * angle) / (0.5 * angle)) ** 2) * mm(K, K)
    )


def orthonormal(R: Array) -> Array:
    """One Newton step towards the nearest rotation: takes out the rounding of a product."""
    return 1.5 * R - 0.5 * mm(R, mm(R.T, R))
