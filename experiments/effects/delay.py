"""Late commands: what the joint controllers receive was sent some time ago; and the unknown phase of the loops."""

import jax.numpy as jnp

from experiments.effects.effect import Effect, Parameter
from sea_jax.delay_line import LONGEST, delayed


def _command(p, command, s, memory):
    # position_mode is remembered shifted by one so that the memory's zeros mean 'nothing sent yet: hold what is now'
    now = jnp.stack([command.torque, command.position, command.position_mode + 1.0], -1)
    past = memory.reshape(now.shape[0], LONGEST, 3)
    past = jnp.where(past[..., 2:] == 0.0, now[:, None], past)
    history = jnp.concatenate([now[:, None], past], 1)
    periods = p.delay / s.period
    mode = jnp.round(delayed(history[..., 2], periods) - 1.0)
    late = command._replace(
        torque=delayed(history[..., 0], periods),
        position=delayed(history[..., 1], periods),
        position_mode=mode,
    )
    return late, history[:, :LONGEST].reshape(memory.shape)


def _timing(p, timing, *_):
    return timing._replace(loop_phase=timing.loop_phase + p.phase, angle_lead=timing.angle_lead + p.angle_lead)


def _torque(p, torque, s, memory):
    late = p.torque_lag / s.period  # share of a step of the current loop
    return torque + late * (memory[:, 0] - torque), torque[:, None]


# No missing effect but what nobody knows of a log: when within a row its loops run, and how its plant takes its steps.
LOOP_TIMING = Effect(
    "loop_timing",
    "the velocity loops run later than the rows, and the plant's time steps are not the model's",
    "drive",
    "joint",
    (
        Parameter("phase", "s", 0.0, 5e-4, 1e-4),
        Parameter("angle_lead", "s", -1e-4, 1e-4, 5e-5),
        Parameter("torque_lag", "s", -5e-5, 1e-4, 5e-5),
    ),
    {"loop_timing": _timing, "motor_torque": _torque},
    memory=1,
)
EFFECTS = (
    Effect(
        "command_delay",
        "commands reach the joint controllers late",
        "drive",
        "joint",
        (Parameter("delay", "s", 0.0, 0.02, 0.002),),
        {"command": _command},
        memory=3 * LONGEST,
        seeds=({"delay": 0.0006}, {"delay": 0.006}),
        sharp=True,
    ),
)
