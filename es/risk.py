"""From the costs of K perturbed trials to one cost per candidate: mean, worst case, conditional value at risk."""

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from es.checks import check_number


@dataclass(frozen=True)
class Risk:
    """How a candidate's trials are judged. Hashable, so it can be a static argument.

    `alpha` in [0, 1) belongs to "cvar", the mean of the worst share 1 - alpha of the trials: 0 is the mean of all.
    """

    measure: Literal["mean", "worst", "cvar"] = "mean"
    alpha: float = 0.0

    def __post_init__(self) -> None:
        if self.measure not in ("mean", "worst", "cvar"):
            raise ValueError(f"unknown risk measure '{self.measure}'; there are mean, worst and cvar")
        check_number("the alpha of a risk measure", self.alpha, at_least=0.0, below=1.0)
        if self.alpha and self.measure != "cvar":
            raise ValueError(f"the risk measure '{self.measure}' takes no alpha")

    def weights(self, trials: int) -> np.ndarray:
        """(K,) weights of the costs sorted ascending, summing to one (Rockafellar and Uryasev 2002, Prop. 8).

        Where (1 - alpha) K is not a whole number, the trial at the edge of the tail counts with the fraction left.
        """
        if trials < 1:
            raise ValueError("a risk measure needs at least one trial per candidate")
        tail = {"mean": float(trials), "worst": 1.0, "cvar": max((1.0 - self.alpha) * trials, 1.0)}[self.measure]
        # rounding alone must not let (1 - 0.9) 10 spill into a second trial
        tail = float(round(tail)) if abs(tail - round(tail)) < 1e-9 * trials else tail
        from_worst = np.arange(trials)[::-1]
        return np.clip(tail - from_worst, 0.0, 1.0) / tail


def reduce_costs(costs: jax.Array, risk: Risk) -> jax.Array:
    """(P, K) costs over K trials to (P,); a trial whose cost is not finite counts as infinitely bad."""
    weights = jnp.asarray(risk.weights(costs.shape[-1]), costs.dtype)[None, :]
    ascending = jnp.sort(jnp.where(jnp.isfinite(costs), costs, jnp.inf), axis=-1)
    return jnp.sum(jnp.where(weights > 0.0, weights * ascending, 0.0), axis=-1)
