"""The force distribution (eq. 6) without corners: ADMM alone, with rounded limits.

The polish goes from one set of active limits to another, so it has no place here; what the ADMM leaves is pushed up to
the least load and into the cone by rounded laws.
"""

from functools import partial

import jax
import jax.numpy as jnp

from controller_jax.force_admm import admm
from controller_jax.force_distribution import DistributionState
from controller_jax.force_problem import DistributionSettings, SupportLegs, force_problem
from experiments.smooth.laws import Widths, clip, shrink_to, softplus

Array = jax.Array
ITERATIONS = 10  # of the ADMM, warm-started
TINY = 1e-12  # N^2


def smooth_forces(
    widths: Widths, settings: DistributionSettings, state: DistributionState, legs: SupportLegs, wrench: Array
) -> DistributionState:
    """Forces (4, 3) for a wrench (6,), control frame, N; they and their multipliers are the next warm start."""
    problem = force_problem(settings, legs, wrench)
    rounded = partial(clip, width=widths.force)
    force, multiplier = admm(problem, state.force, state.multiplier, ITERATIONS, rounded)
    least = settings.minimal_normal * legs.load
    normal = least + softplus(force[:, 2] - least, widths.force)
    inside = shrink_to(tangential(force), settings.friction * normal)
    return DistributionState(jnp.stack([inside * force[:, 0], inside * force[:, 1], normal], -1), multiplier)


def tangential(force: Array) -> Array:
    """Size (4,) of the forces (4, 3) along the ground, N."""
    return jnp.sqrt(force[:, 0] ** 2 + force[:, 1] ** 2 + TINY)
