"""Drag on the links themselves, beyond the measured spring torque: seals, cables, bearings of the joints."""

import jax.numpy as jnp

from experiments.effects.effect import Effect, Parameter

CREEP = 0.02  # rad/s below which dry drag is proportional to speed: the bodies treat it implicitly, so it may be steep


def _coulomb(p, drag, s):
    return drag + p.torque * jnp.clip(s.joint_velocity / CREEP, -1.0, 1.0)


def _bearings(p, drag, s):
    return drag + p.coefficient * s.radial_load * jnp.clip(s.joint_velocity / CREEP, -1.0, 1.0)


def _viscous(p, drag, s):
    return drag + p.coefficient * s.joint_velocity


# Every robot has some, and no log tells it from dry drag well enough to be accused.
BEARING_FRICTION = Effect(
    "bearing_friction",
    "the joints' bearings rub in proportion to the force across them, after the torque sensor (paper IV.5)",
    "bodies",
    "joint",
    (Parameter("coefficient", "m, N m per N", 0.0, 0.01, 5e-4),),
    {"joint_drag": _bearings},
)
EFFECTS = (
    Effect(
        "joint_coulomb_drag",
        "dry friction on the link, after the torque sensor",
        "bodies",
        "joint",
        (Parameter("torque", "N m", 0.0, 10.0, 0.3),),
        {"joint_drag": _coulomb},
    ),
    Effect(
        "joint_viscous_drag",
        "friction on the link that grows with its speed, after the torque sensor",
        "bodies",
        "joint",
        (Parameter("coefficient", "N m s/rad", 0.0, 5.0, 0.1),),
        {"joint_drag": _viscous},
    ),
    BEARING_FRICTION,
)
