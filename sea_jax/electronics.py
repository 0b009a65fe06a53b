"""Motor electronics (paper IV.3): L dI/dt = V - R I - K_e w, solved exactly while V and w are held.

R T / L = 0.59 at 0.1 ms: explicit Euler would be stable, but its pole 0.41 stands where the winding has
exp(-0.59) = 0.55. The exponential costs nothing more, as it is the same in every step.
"""

from typing import NamedTuple

import jax.numpy as jnp

from sea_jax.parameters import DriveParams
from sea_jax.types import Array


class Winding(NamedTuple):
    """The step response of the winding over one period, computed once."""

    conductance: Array  # 1/Ohm
    back_emf: Array  # V s/rad, per gear velocity
    decay: Array  # what is left of a current after one period
    mean_decay: Array  # the same, averaged over the period


def winding(params: DriveParams, period: float) -> Winding:
    """The winding's constants for a voltage held over `period` seconds."""
    exponent = params.resistance * period / params.inductance
    return Winding(
        conductance=1.0 / params.resistance,
        back_emf=params.back_emf_constant * params.gear_ratio,
        decay=jnp.exp(-exponent),
        mean_decay=-jnp.expm1(-exponent) / exponent,
    )


def electronics(coil: Winding, voltage: Array, velocity: Array, current: Array) -> tuple[Array, Array]:
    """Current at the end of the period and its mean over it, A; velocity at the gear output, rad/s."""
    steady = (voltage - coil.back_emf * velocity) * coil.conductance
    excess = current - steady
    return steady + coil.decay * excess, steady + coil.mean_decay * excess
