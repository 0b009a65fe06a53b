"""Gear to link: backlash, and a spring that is stiffer, stiffening, lossier or hysteretic."""

import jax.numpy as jnp

from experiments.effects.effect import Effect, Parameter


def _backlash(p, deflection, _):
    return deflection - jnp.clip(deflection, -p.half_width, p.half_width)


def _loose(p, torque, s):
    # within the play nothing touches, the spring's damper included
    return jnp.where((p.half_width > 0.0) & (s.deflection == 0.0), 0.0, torque)


def _stiffness(p, params, _):
    return params._replace(spring_stiffness=params.spring_stiffness * (1.0 + p.relative))


def _stiffening(p, torque, s):
    return torque + p.cubic * s.deflection**3


def _damping(p, params, _):
    return params._replace(spring_damping=params.spring_damping + p.coefficient)


def _hysteresis(p, torque, s, memory):
    # Dahl's model: dz = (1 - z sgn(rate)) rate dt / width, solved exactly for a constant rate, |z| <= 1
    z = memory[..., 0]
    direction = jnp.sign(s.deflection_rate)
    decay = jnp.exp(-jnp.abs(s.deflection_rate) * s.period / p.width)
    z = direction + (z - direction) * decay
    return torque + p.torque * z, z[..., None]


EFFECTS = (
    Effect(
        "backlash",
        "play between gear and spring: the link moves freely within a small angle",
        "drive",
        "joint",
        (Parameter("half_width", "rad", 0.0, 0.15, 0.01),),
        {"deflection": _backlash, "spring": _loose},
        seeds=({"half_width": 0.002}, {"half_width": 0.03}),
        sharp=True,
    ),
    Effect(
        "spring_stiffness",
        "the spring is stiffer or softer than nominal",
        "drive",
        "joint",
        (Parameter("relative", "1", -0.7, 2.0, 0.1),),
        {"drive_parameters": _stiffness},
    ),
    Effect(
        "spring_stiffening",
        "the spring grows stiffer with its deflection",
        "drive",
        "joint",
        (Parameter("cubic", "N m/rad^3", -300.0, 20000.0, 30.0),),
        {"spring": _stiffening},
        sharp=True,
    ),
    Effect(
        "spring_damping",
        "the spring loses more or less energy with deflection speed than nominal",
        "drive",
        "joint",
        (Parameter("coefficient", "N m s/rad", -0.3, 3.0, 0.1),),
        {"drive_parameters": _damping},
    ),
    Effect(
        "spring_hysteresis",
        "the spring's torque lags its deflection at any speed (dry friction inside the spring)",
        "drive",
        "joint",
        (
            Parameter("torque", "N m", 0.0, 10.0, 0.5),
            Parameter("width", "rad", 0.001, 0.5, 0.02, "shape"),
        ),
        {"spring": _hysteresis},
        memory=1,
        sharp=True,
    ),
)
