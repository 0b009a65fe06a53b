"""A user's own effect in one short file: magnets pull the rotor towards certain angles (cogging torque).

starleth diagnose log.csv.gz --effects cogging.py
starleth learn log.csv.gz --effects cogging.py --effect cogging@LH_KFE
"""

import jax.numpy as jnp

from experiments.effects import Effect, Parameter

POLES = 4.0 * 100.0  # periods per turn of the gear output: two pole pairs, a gear of 1:100


def cogging(p, torque, signals):
    """Torque at the rotor, N m: what it was, and the pull of the magnets."""
    angle = POLES * signals.motor_position
    return torque + p.sine * jnp.sin(angle) + p.cosine * jnp.cos(angle)


EFFECT = Effect(
    name="cogging",
    about="the motor's magnets pull the rotor towards certain angles",
    part="drive",
    axis="joint",
    parameters=(
        Parameter("sine", "N m at the rotor", -0.1, 0.1, 0.005),
        Parameter("cosine", "N m at the rotor", -0.1, 0.1, 0.005),
    ),
    equations={"motor_torque": cogging},
    fine=True,  # many periods within a joint's motion: only time tells whether it is steady
)
