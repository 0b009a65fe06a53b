"""Friction of motor and gear that the nominal law c0 sgn(w) + c1 w + c2 w^3 lacks or has wrong (paper IV.5)."""

import jax.numpy as jnp

from experiments.effects.effect import Effect, Parameter


def _coulomb(p, params, _):
    return params._replace(friction_coulomb=params.friction_coulomb + p.torque)


def _viscous(p, params, _):
    return params._replace(friction_viscous=params.friction_viscous + p.coefficient)


def _cubic(p, params, _):
    return params._replace(friction_cubic=params.friction_cubic + p.coefficient)


def _stribeck(p, friction, s):
    bump = jnp.exp(-((s.motor_velocity / p.velocity) ** 2))
    return friction._replace(coulomb=friction.coulomb + p.torque * bump)


def _load(p, friction, s):
    return friction._replace(coulomb=friction.coulomb + p.coefficient * jnp.abs(s.spring_torque))


def _direction(p, friction, _):
    # (c0 + a sgn w) sgn w = c0 sgn w + a: a level that depends on the direction is a constant torque
    return friction._replace(smooth=friction.smooth + p.torque)


def _direction_viscous(p, friction, s):
    # (c1 + b sgn w) w = c1 w + b |w|
    return friction._replace(smooth=friction.smooth + p.coefficient * jnp.abs(s.motor_velocity))


EFFECTS = (
    Effect(
        "coulomb_friction",
        "dry friction of the gear is larger or smaller than nominal",
        "drive",
        "joint",
        (Parameter("torque", "N m at the rotor", -0.012, 0.2, 0.004),),
        {"drive_parameters": _coulomb},
    ),
    Effect(
        "viscous_friction",
        "friction that grows with motor speed is larger or smaller than nominal",
        "drive",
        "joint",
        (Parameter("coefficient", "N m s/rad at the rotor", -2.5e-5, 1e-3, 2e-5),),
        {"drive_parameters": _viscous},
    ),
    Effect(
        "cubic_friction",
        "friction that grows with the third power of motor speed",
        "drive",
        "joint",
        (Parameter("coefficient", "N m s^3/rad^3 at the rotor", -1e-9, 1e-8, 1e-10),),
        {"drive_parameters": _cubic},
    ),
    Effect(
        "stribeck_friction",
        "dry friction is higher near standstill and falls with speed",
        "drive",
        "joint",
        (
            Parameter("torque", "N m at the rotor", -0.012, 0.2, 0.006),
            # a gear that is slower than 0.01 rad/s counts as held, and tells of no law
            Parameter("velocity", "rad/s at the gear output", 0.015, 3.0, 0.3, "shape"),
        ),
        {"friction": _stribeck},
        seeds=({"velocity": 0.05}, {"velocity": 1.0}),
        sharp=True,
    ),
    Effect(
        "load_friction",
        "dry friction of the gear grows with the torque that it carries",
        "drive",
        "joint",
        (Parameter("coefficient", "N m at the rotor per N m at the joint", -1e-3, 1e-2, 5e-4),),
        {"friction": _load},
    ),
    Effect(
        "direction_dependent_friction",
        "dry friction differs between the two directions of motion",
        "drive",
        "joint",
        (Parameter("torque", "N m at the rotor", -0.1, 0.1, 0.003),),
        {"friction": _direction},
    ),
    Effect(
        "direction_dependent_viscous_friction",
        "friction grows with speed differently in the two directions of motion",
        "drive",
        "joint",
        (Parameter("coefficient", "N m at the rotor per rad/s at the gear output", -0.05, 0.05, 2e-3),),
        {"friction": _direction_viscous},
    ),
)
