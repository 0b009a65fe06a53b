"""CMA-ES (Hansen, arXiv:1604.00772): evosax's engine with the parts replaced that a robust search cannot live with.

evosax 0.3.2 supplies the constants, the state and the update of mean, step size, paths and covariance. Replaced are

* the draw: x = m + sigma z B D B^T (the symmetric root of C) in place of z D B^T. The law is the same, but an
  eigenbasis is only defined up to sign and rotation, so a change of 1e-7 in C could give entirely different samples;
  the symmetric root is continuous in C.
* the ranking: ordinal, so that ties never give weights that do not sum to one, and with failures graded;
* the metrics, which are not used.

Everything here works in normalised coordinates and runs on one CPU device, so that the search is the same whatever
the evaluation is sharded over. LAPACK's eigh is called once a generation, outside any vmapped rollout.
"""

from functools import cache, partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from es.numerics import library_numerics

if TYPE_CHECKING:
    from evosax.algorithms.distribution_based.cma_es import CMA_ES, State

# Keeps sigma from underflowing to zero, which would turn (x - m) / sigma into NaN; far below any useful tolerance.
SMALLEST_SIGMA = 1e-10
# Wider than any box in normalised coordinates; keeps exp(...) of the step-size rule finite.
LARGEST_SIGMA = 1e4
# With fewer there is no ranking to learn a covariance from.
SMALLEST_POPULATION = 4


def search_device() -> jax.Device:
    """The one device that draws and ranks: this process's first CPU, or its first device where there is no CPU."""
    try:
        return jax.local_devices(backend="cpu")[0]
    except RuntimeError:
        return jax.local_devices()[0]


@cache
def make_engine(population: int, size: int) -> "CMA_ES":
    """The evosax strategy for P candidates of n parameters; built once, as JAX compiles per object.

    Raises ValueError if the population is too small to rank.
    """
    if population < SMALLEST_POPULATION:
        raise ValueError(f"the population must be at least {SMALLEST_POPULATION}, not {population}")
    # Not at the top: importing evosax starts JAX's backend, after which the number of devices cannot be set.
    from evosax.algorithms.distribution_based.cma_es import CMA_ES, eigen_decomposition

    class SymmetricCMA(CMA_ES):
        """evosax's CMA-ES with the symmetric root in eq. (39)."""

        def draw(self, key: jax.Array, state: "State") -> jax.Array:
            """(P, n) samples of N(m, sigma^2 C) by the decomposition that the state holds."""
            z = jax.random.normal(key, (self.population_size, self.num_dims))  # eq. (38)
            y = ((z @ state.B) * state.D[None, :]) @ state.B.T  # eq. (39), symmetric
            return state.mean[None, :] + state.std * y  # eq. (40)

        def _ask(self, key: jax.Array, state: "State", params: Any) -> tuple[jax.Array, "State"]:
            C, B, D = eigen_decomposition(state.C)
            state = state.replace(C=C, B=B, D=D)
            return self.draw(key, state), state

    with library_numerics():
        engine = SymmetricCMA(population, jnp.zeros(size), fitness_shaping_fn=ordinal_weights, metrics_fn=lambda *_: {})
        engine.params = engine.default_params.replace(std_min=SMALLEST_SIGMA, std_max=LARGEST_SIGMA)
    return engine


def ordinal_weights(told: jax.Array, costs: jax.Array, state: "State", params: Any) -> jax.Array:
    """(P,) recombination weights by ordinal rank: each weight is given out exactly once.

    Ties are broken by index, which is blind to where the samples lie. Costs that are not finite rank after all others
    and among themselves by their Mahalanobis distance from the mean: a generation in which everything fails draws the
    search back towards where it came from.
    """
    failed = ~jnp.isfinite(costs)
    distance = jnp.linalg.norm(((told - state.mean[None, :]) @ state.B) / state.D[None, :], axis=-1)
    order = jnp.lexsort((jnp.where(failed, distance, costs), failed))
    rank = jnp.zeros(costs.shape, jnp.int32).at[order].set(jnp.arange(costs.size, dtype=jnp.int32))
    return params.weights[rank]


def start(engine: "CMA_ES", mean: np.ndarray, sigma: float) -> "State":
    """State at the normalised mean (n,) with the standard deviation sigma in every direction."""
    with jax.default_device(search_device()), library_numerics():
        params = engine.params.replace(std_init=jnp.float32(sigma))
        state = engine.init(jax.random.key(0), jnp.asarray(mean, jnp.float32), params)  # the key is not used
    return on_search_device(state)  # through NumPy, which drops weak types: a restored state has none either


@partial(jax.jit, static_argnums=0)
def tell(engine: "CMA_ES", state: "State", told: jax.Array, costs: jax.Array) -> "State":
    """Next state from the normalised samples (P, n) and what each cost (P,), in any unit, NaN and inf allowed."""
    with library_numerics():
        state, _ = engine.tell(jax.random.key(0), told, costs, state, engine.params)  # the key is not used
    return state


def widest_deviation(state: "State") -> float:
    """Standard deviation along the longest axis of the distribution, normalised."""
    return float(np.float64(state.std) * np.max(np.asarray(state.D, np.float64)))


def reenter(state: "State", sigma_rescale: float, sigma_floor: float) -> "State":
    """State for a new cost function from the same mean and covariance.

    sigma is multiplied by `sigma_rescale` and then raised until the longest axis has a standard deviation of at least
    `sigma_floor`. The paths are forgotten: they remember steps that another cost rewarded.
    """
    sigma = np.float64(state.std) * sigma_rescale
    sigma = max(sigma, sigma_floor / np.max(np.asarray(state.D, np.float64)))
    fresh = state.replace(
        std=np.float32(sigma),
        p_std=np.zeros_like(state.p_std),
        p_c=np.zeros_like(state.p_c),
        best_solution=np.full_like(state.best_solution, np.nan),
        best_fitness=np.float32(np.inf),
        generation_counter=np.int32(0),
    )
    return on_search_device(fresh)


def on_search_device(state: "State") -> "State":
    """The state, whatever arrays it holds, as JAX arrays on the search's device."""
    return jax.device_put(jax.tree.map(np.asarray, state), search_device())
