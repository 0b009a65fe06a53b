"""Bounds as in the paper (V.C.1): redraw what is outside, up to 1000 times, then project and charge the distance.

CMA-ES is told where a sample was drawn, and its cost is that of the projected point plus the charge. It is not told
the projected point: projected points lie on a face, so learning from them flattens the covariance across that face
and the step size shrinks before the optimum is found. The charge is what brings the distribution back.
"""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp

from es.numerics import library_numerics

if TYPE_CHECKING:
    from evosax.algorithms.distribution_based.cma_es import CMA_ES, State

Draws = Callable[[jax.Array], jax.Array]

# Redraws made at once: one loop iteration costs about as much as its overhead; the result does not depend on it.
CHUNK = 64


class Draw(NamedTuple):
    """One generation, normalised."""

    told: jax.Array  # (P, n) samples as drawn, outside the box only where every redraw was: for `tell`
    inside: jax.Array  # (P, n) the same, projected to the box: to be evaluated
    distance: jax.Array  # (P,) Euclidean distance between the two, 0 for a sample drawn inside
    redraws: jax.Array  # (P,) int32, how often each candidate was redrawn


@partial(jax.jit, static_argnums=0)
def ask(
    engine: "CMA_ES", state: "State", key: jax.Array, generation: jax.Array, high: jax.Array, redraws: jax.Array
) -> tuple[Draw, "State"]:
    """Draw P candidates in the normalised box [0, high]; also returns the state, now with its decomposition.

    Redraw i of a candidate depends on `key`, `generation` and i alone, whatever the other candidates do. A redraw
    replaces the whole vector, which keeps the law that of the Gaussian given the box.
    """
    key = jax.random.fold_in(key, generation)
    with library_numerics():
        told, state = engine.ask(key, state, engine.params)

    def draws(attempts: jax.Array) -> jax.Array:
        return jax.vmap(lambda attempt: engine.draw(jax.random.fold_in(key, attempt), state))(attempts)

    told, count = redraw_outside(told, draws, high, redraws)
    inside = jnp.clip(told, jnp.zeros_like(told), high[None, :])
    return Draw(told, inside, jnp.linalg.norm(told - inside, axis=-1), count), state


def outside(samples: jax.Array, high: jax.Array) -> jax.Array:
    """(..., n) samples to (...) booleans: not in the box [0, high]."""
    return jnp.any((samples < 0.0) | (samples > high.reshape((1,) * (samples.ndim - 1) + (-1,))), axis=-1)


def redraw_outside(first: jax.Array, draws: Draws, high: jax.Array, redraws: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Replace each candidate of `first` (P, n) that is outside by the first of its redraws that is not.

    `draws` maps attempts (a,) in 1..redraws to samples (a, P, n). A candidate whose redraws all lie outside ends as
    the last of them. Returns the candidates (P, n) and the number of redraws of each (P,).
    """

    def unfinished(carry) -> jax.Array:
        attempt, candidates, _ = carry
        return (attempt <= redraws) & outside(candidates, high).any()

    def next_chunk(carry):
        attempt, candidates, count = carry
        attempts = attempt + jnp.arange(CHUNK, dtype=jnp.int32)
        samples = draws(attempts)
        allowed = attempts <= redraws
        valid = allowed[:, None] & ~outside(samples, high)
        chosen = jnp.where(valid.any(axis=0), jnp.argmax(valid, axis=0), allowed.sum() - 1)
        redrawn = jnp.take_along_axis(samples, chosen[None, :, None], axis=0)[0]
        pending = outside(candidates, high)
        candidates = jnp.where(pending[:, None], redrawn, candidates)
        count = jnp.where(pending, attempts[chosen], count)
        return attempt + CHUNK, candidates, count

    begin = (jnp.int32(1), first, jnp.zeros(first.shape[0], jnp.int32))
    _, candidates, count = jax.lax.while_loop(unfinished, next_chunk, begin)
    return candidates, count
