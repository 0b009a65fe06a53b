"""Sensors that do not tell the truth: encoder offset, torque sensor gain and offset, delay.

Each has a forward equation (`measurement`: what the controllers see and the log holds) and, where it falsifies
the link's motion, the inverse (`measured_motion`) by which a replay recovers the true motion from the log. A delay is
known to replays by its times alone (`replay_timing`), which they take into account to a fraction of a row.
"""

import jax.numpy as jnp

from experiments.effects.effect import Effect, Parameter
from sea_jax.delay_line import LONGEST, delayed


def _offset(p, measurement, _):
    return measurement._replace(position=measurement.position + p.offset)


def _remove_offset(p, motion, _):
    return motion._replace(position=motion.position - p.offset)


def _gain(p, measurement, _):
    return measurement._replace(torque=measurement.torque * (1.0 + p.relative))


def _torque_offset(p, measurement, _):
    return measurement._replace(torque=measurement.torque + p.offset)


def _late(p, measurement, s, memory):
    # memory holds 1 + value, so that its zeros mean 'no past yet: hold what is now'
    now = jnp.stack([measurement.position, measurement.velocity, measurement.torque, measurement.motor_position], -1)
    past = memory.reshape(now.shape[0], LONGEST, 5)
    known = past[..., 4:] > 0.0
    past = jnp.concatenate([jnp.where(known, past[..., :4], now[:, None]), jnp.ones_like(past[..., 4:])], -1)
    history = jnp.concatenate([jnp.concatenate([now, jnp.ones_like(now[:, :1])], -1)[:, None], past], 1)
    link, drive = p.joint_side / s.period, p.motor_side / s.period
    late = measurement._replace(
        position=delayed(history[..., 0], link),
        velocity=delayed(history[..., 1], link),
        torque=delayed(history[..., 2], drive),
        motor_position=delayed(history[..., 3], drive),
    )
    return late, history[:, :LONGEST].reshape(memory.shape)


def _ages(p, timing, _):
    return timing._replace(link_age=timing.link_age + p.joint_side, drive_age=timing.drive_age + p.motor_side)


EFFECTS = (
    Effect(
        "joint_encoder_offset",
        "the link encoder's zero is wrong",
        "sensors",
        "joint",
        (Parameter("offset", "rad", -0.3, 0.3, 0.01),),
        {"measurement": _offset, "measured_motion": _remove_offset},
    ),
    Effect(
        "torque_sensor_gain",
        "the torque sensor shows too much or too little, in proportion",
        "sensors",
        "joint",
        (Parameter("relative", "1", -0.6, 1.0, 0.1),),
        {"measurement": _gain},
    ),
    Effect(
        "torque_sensor_offset",
        "the torque sensor shows a torque where there is none",
        "sensors",
        "joint",
        (Parameter("offset", "N m", -5.0, 5.0, 0.3),),
        {"measurement": _torque_offset},
    ),
    Effect(
        "sensor_delay",
        "sensors show the past: the link's encoder, or the drive's own sensors",
        "sensors",
        "joint",
        (
            Parameter("joint_side", "s", 0.0, 0.02, 0.002),
            Parameter("motor_side", "s", 0.0, 0.02, 0.002),
        ),
        {
            "measurement": _late,
            "replay_timing": _ages,
        },
        memory=5 * LONGEST,
        sharp=True,
    ),
)
