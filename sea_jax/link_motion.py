"""True link motion from what the joint encoders measured: input of a replay.

Position and velocity are both measured, so each row is the Rauch-Tung-Striebel estimate of (q, qd) under white
acceleration. Without it the encoder noise passes through the knee's stop (300 N m/rad) into the joint torque.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from sea_jax.types import Array, JointMotion

# Acceleration taken for a joint that does not move, as a share of what the velocity noise looks like.
LEAST_ACCELERATION = 1e-3


class Estimate(NamedTuple):
    """Mean and covariance of position and turn, which is velocity times period, (J,) each."""

    position: Array  # rad
    turn: Array  # rad
    pp: Array  # rad^2
    pt: Array
    tt: Array


class Noise(NamedTuple):
    """Variances, rad^2."""

    position: float  # of the measured position
    turn: float  # of the measured velocity times period
    process: Array  # (J,) of what the acceleration adds to the turn in a period


def link_motion(position: Array, velocity: Array, period: float) -> JointMotion:
    """Measured rows (T, J) as link motion: constant acceleration between rows, no radial load."""
    step = jnp.diff(velocity, axis=0) / period
    acceleration = jnp.concatenate([step, jnp.zeros_like(step[:1])])
    return JointMotion(position, velocity, acceleration, jnp.zeros_like(position))


def smoothed_link_motion(
    position: Array, velocity: Array, period: float, position_noise: float, velocity_noise: float
) -> JointMotion:
    """Link motion from noisy rows (T, J); the noise is given as standard deviations, rad and rad/s."""
    noise_p, noise_t = position_noise**2, (period * velocity_noise) ** 2
    jumps = jnp.var(jnp.diff(velocity, axis=0), axis=0) * period**2
    process = jnp.maximum(jumps - 2.0 * noise_t, LEAST_ACCELERATION * noise_t)
    noise = Noise(noise_p, noise_t, process)

    def forward(x: Estimate, row: tuple[Array, Array]) -> tuple[Estimate, Estimate]:
        x = _corrected(_predicted(x, noise), *row, noise)
        return x, x

    def backward(later: tuple[Array, Array], x: Estimate) -> tuple[tuple, tuple]:
        smooth = _smoothed(x, _predicted(x, noise), *later)
        return smooth, smooth

    turns = velocity * period
    ones = jnp.ones_like(position[0])
    first = Estimate(position[0], turns[0], noise_p * ones, 0.0 * ones, noise_t * ones)
    last, filtered = jax.lax.scan(forward, first, (position[1:], turns[1:]))
    earlier = jax.tree.map(lambda x, xs: jnp.concatenate([x[None], xs[:-1]]), first, filtered)
    _, (smooth_q, smooth_t) = jax.lax.scan(backward, (last.position, last.turn), earlier, reverse=True)
    smooth_q = jnp.concatenate([smooth_q, last.position[None]])
    smooth_t = jnp.concatenate([smooth_t, last.turn[None]])
    return link_motion(smooth_q, smooth_t / period, period)


def _predicted(x: Estimate, noise: Noise) -> Estimate:
    """One period later, under white acceleration."""
    return Estimate(
        x.position + x.turn,
        x.turn,
        x.pp + 2.0 * x.pt + x.tt + noise.process / 3.0,
        x.pt + x.tt + noise.process / 2.0,
        x.tt + noise.process,
    )


def _corrected(x: Estimate, q: Array, turn: Array, noise: Noise) -> Estimate:
    """With a measured row taken in (Kalman)."""
    s_pp, s_tt = x.pp + noise.position, x.tt + noise.turn
    det = s_pp * s_tt - x.pt * x.pt
    gain_pp = (x.pp * s_tt - x.pt * x.pt) / det
    gain_pt = x.pt * noise.position / det
    gain_tp = x.pt * noise.turn / det
    gain_tt = (x.tt * s_pp - x.pt * x.pt) / det
    dq, dt = q - x.position, turn - x.turn
    return Estimate(
        x.position + gain_pp * dq + gain_pt * dt,
        x.turn + gain_tp * dq + gain_tt * dt,
        (1.0 - gain_pp) * x.pp - gain_pt * x.pt,
        (1.0 - gain_pp) * x.pt - gain_pt * x.tt,
        (1.0 - gain_tt) * x.tt - gain_tp * x.pt,
    )


def _smoothed(x: Estimate, ahead: Estimate, position: Array, turn: Array) -> tuple[Array, Array]:
    """Position and turn, given those of the next row, which were predicted as `ahead` (Rauch, Tung, Striebel)."""
    det = ahead.pp * ahead.tt - ahead.pt * ahead.pt
    cross_p, cross_t = x.pp + x.pt, x.pt + x.tt  # covariance of x with the position ahead
    dq, dt = position - ahead.position, turn - ahead.turn
    weight_q, weight_t = (ahead.tt * dq - ahead.pt * dt) / det, (ahead.pp * dt - ahead.pt * dq) / det
    return (
        x.position + cross_p * weight_q + x.pt * weight_t,
        x.turn + cross_t * weight_q + x.tt * weight_t,
    )
