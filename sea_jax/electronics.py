"""Motor electronics (paper IV.3): L dI/dt = V - R I - K_e w, solved exactly while V and w are held.

R T / L = 0.59 at 0.1 ms: explicit Euler would be stable, but its pole 0.41 stands where the winding has
exp(-0.59) = 0.55. The exponential costs nothing more, as it is the same in every step.

The motor gets the current at the end of the step, as in the paper's discrete model, where the mechanics follow
the electronics. Measured logs are explained to the noise this way; the mean over the step leaves five times the
noise in motor position after every current saturation.
"""

from typing import NamedTuple

import jax.numpy as jnp

from sea_jax.parameters import DriveParams
from sea_jax.types import Array


class Winding(NamedTuple):
    """The step response of the winding over one period, computed once."""

    decay: Array  # what is left of a current after one period
    gain: Array  # A/V: current that a held voltage brings in one period
    back_emf: Array  # V s/rad, per gear velocity


def winding(params: DriveParams, period: float) -> Winding:
    """The winding's constants for a voltage held over `period` seconds."""
    exponent = params.resistance * period / params.inductance
    return Winding(
        decay=jnp.exp(-exponent),
        gain=-jnp.expm1(-exponent) / params.resistance,
        back_emf=params.back_emf_constant * params.gear_ratio,
    )


def electronics(coil: Winding, voltage: Array, velocity: Array, current: Array) -> Array:
    """Current at the end of the period, A; velocity at the gear output, rad/s."""
    return coil.decay * current + coil.gain * (voltage - coil.back_emf * velocity)


def back_emf(params: DriveParams, velocity: Array) -> Array:
    """Voltage that the turning motor induces, V; velocity at the gear output, rad/s."""
    return params.back_emf_constant * params.gear_ratio * velocity


def current_at_once(params: DriveParams, wanted: Array, velocity: Array, bus_voltage: Array) -> Array:
    """Current under a loop that needs no time, A: the wanted one as far as the bus can drive it at this velocity.

    The current loop is ten times faster than anything mechanical.
    """
    induced = back_emf(params, velocity)
    conductance = 1.0 / params.resistance
    return jnp.clip(wanted, (-bus_voltage - induced) * conductance, (bus_voltage - induced) * conductance)
