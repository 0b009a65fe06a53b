"""Motor and supply: inertia, torque constant and its saturation and ripple, sag of the bus voltage."""

import jax.numpy as jnp

from experiments.effects.effect import Effect, Parameter
from sea_jax.trigonometry import sine_cosine


def _inertia(p, params, _):
    return params._replace(motor_inertia=params.motor_inertia * (1.0 + p.relative))


def _torque_constant(p, torque, _):
    return torque * (1.0 + p.relative)


def _saturation(p, torque, s):
    # K / (1 + c I^2): falls as 1 - c I^2 at first, and never turns round
    return torque / (1.0 + p.per_square_current * s.current * s.current)


def _ripple(p, torque, s):
    # of the poles, in proportion to the current, and of the magnets (cogging), without one
    sine, cosine = sine_cosine(p.harmonic * s.motor_position)
    return torque + (p.sine * torque + p.constant_sine) * sine + (p.cosine * torque + p.constant_cosine) * cosine


def _sag(p, voltage, s):
    # V = V_0 - R i: a switching amplifier draws its motor's power, i = sum(U I) / V, a linear one its motor's current
    power = jnp.maximum((s.winding_voltage * s.current).sum(), 0.0)  # braking motors feed the others, not the supply
    half = 0.5 * voltage  # a supply gives most power there: it falls no further
    linear = jnp.maximum(voltage - p.resistance * (1.0 - p.switching) * jnp.abs(s.current).sum(), half)
    drop = p.resistance * p.switching * power  # V^2
    root = jnp.sqrt(jnp.maximum(jnp.square(linear) - 4.0 * drop, jnp.square(0.02 * half)))  # a slope at its end, too
    return jnp.maximum(linear - 2.0 * drop / (linear + root), half)


EFFECTS = (
    Effect(
        "motor_inertia",
        "rotor and gear turn more or less inertia than nominal",
        "drive",
        "joint",
        (Parameter("relative", "1", -0.8, 4.0, 0.2),),
        {"drive_parameters": _inertia},
    ),
    Effect(
        "torque_constant",
        "a motor gives more or less torque per ampere than nominal",
        "drive",
        "joint",
        (Parameter("relative", "1", -0.6, 0.6, -0.1),),
        {"motor_torque": _torque_constant},
    ),
    Effect(
        "torque_constant_saturation",
        "torque per ampere falls at high current (magnetic saturation)",
        "drive",
        "joint",
        (Parameter("per_square_current", "1/A^2", 0.0, 0.05, 0.005),),
        {"motor_torque": _saturation},
        sharp=True,
    ),
    Effect(
        "torque_ripple",
        "the motor's torque varies with the rotor's angle, with its current or without",
        "drive",
        "joint",
        (
            Parameter("sine", "1", -0.5, 0.5, 0.05),
            Parameter("cosine", "1", -0.5, 0.5, 0.05),
            Parameter("constant_sine", "N m at the rotor", -0.1, 0.1, 0.002),
            Parameter("constant_cosine", "N m at the rotor", -0.1, 0.1, 0.002),
            Parameter("harmonic", "periods per turn of the gear output", 10.0, 3000.0, 600.0, "shape"),
        ),
        {"motor_torque": _ripple},
        fine=True,
    ),
    Effect(
        "bus_voltage_sag",
        "the supply falls with the current that all motors draw",
        "drive",
        "joint",
        (
            Parameter("resistance", "ohm", 0.0, 20.0, 0.7),
            Parameter("switching", "share of the amplifiers that switch", 0.0, 1.0, 1.0, "shape"),
        ),
        {"supply_voltage": _sag},
        seeds=({"switching": 0.0},),
        sharp=True,
    ),
)
