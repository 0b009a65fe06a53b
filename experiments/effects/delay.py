"""Late commands: what the joint controllers receive was sent some time ago; and the unknown phase of the loops."""

import jax.numpy as jnp

from experiments.effects.effect import Effect, Parameter

LONGEST = 8  # control periods that the memory holds: 20 ms at 400 Hz


def delayed(history, delay_in_periods):
    """Linear interpolation in a history (places, LONGEST + 1), newest first, at a delay in periods (places,)."""
    age = jnp.arange(LONGEST + 1, dtype=history.dtype)[None, :]
    late = delay_in_periods[:, None] - age
    # a hat around each age, written so that its slope at a whole number of periods is that towards later
    weight = jnp.where(late < 0.0, 1.0 + late, 1.0 - late)
    inside = (late >= -1.0) & (late < 1.0)
    return jnp.where(inside, weight * history, 0.0).sum(-1)


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


def _commanded_velocity(p, velocity, s, memory):
    late = p.lag / s.period  # of the period that still runs on the last one's velocity
    return (1.0 - late) * velocity + late * memory[:, 0], velocity[:, None]


# No missing effect but what nobody knows of a log: where in the control period the velocity loops run.
LOOP_LAG = Effect(
    "loop_lag",
    "the velocity loops get their command late in the control period",
    "drive",
    "joint",
    (Parameter("lag", "s", -5e-4, 5e-4, 1e-4),),
    {"commanded_velocity": _commanded_velocity},
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
    ),
)
