"""Friction of gear and bearings (paper IV.5): tau_f in c0 Sgn(w) + c1 w + c2 w^3, with Sgn(0) = [-1, 1].

The set-valued part is solved implicitly: the velocity after the step is the proximal point of the free
velocity, so that a motor held by less than the Coulomb level stands still exactly.
"""

from typing import NamedTuple

import jax.numpy as jnp

from sea_jax.parameters import DriveParams
from sea_jax.types import Array


class Friction(NamedTuple):
    """Friction torque at the rotor, (J,) N m."""

    coulomb: Array  # level of the set-valued part, >= 0
    smooth: Array  # the part that is a function of the state, against positive velocity where positive


def coulomb_level(params: DriveParams, radial_load: Array) -> Array:
    """Coulomb torque at the rotor, N m: gear, and bearing by the size of its load, N.

    An approximation: friction of the joint's bearing (paper IV.5) opposes the joint's speed (FACTS 2.2); here it
    opposes the rotor's and acts before the spring. That is the same, reflected through the gear, while both move
    together; where the spring lets the joint move and the motor stands, the link feels none of it.
    """
    return params.friction_coulomb + params.bearing_friction * jnp.abs(radial_load) / params.gear_ratio


def gear_friction(params: DriveParams, coulomb: Array, velocity: Array) -> Friction:
    """Friction at the rotor; velocity at the gear output, rad/s."""
    rotor = params.gear_ratio * velocity
    return Friction(coulomb, rotor * (params.friction_viscous + params.friction_cubic * rotor * rotor))


def stick_or_slip(free_velocity: Array, reach: Array) -> Array:
    """Velocity after a step: exactly 0 where friction can take away (reach) all of the free velocity."""
    return free_velocity - jnp.clip(free_velocity, -reach, reach)
