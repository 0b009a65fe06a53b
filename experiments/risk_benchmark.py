"""Is a robust search worth its price? The search as the task has it, and the same judged by the CVaR of more trials.

Both are then tried on the same perturbed trials, which neither has seen; what differs is told with its 95 %
interval.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from es import Risk
from experiments.batch import CHUNK, local_mesh
from experiments.evaluation import Evaluation, crossed
from experiments.robustness.statistics import paired_difference, success_interval
from experiments.robustness.trials import STREAM
from experiments.rollout import Score
from experiments.tune import TAIL, TuneOptions

PLAIN, ROBUST = "plain", "cvar"
CVAR = Risk("cvar", TAIL)


def searches(options: TuneOptions, trials: int, seeds: int) -> dict[tuple[str, int], TuneOptions]:
    """Options of every search by method and seed: the task as it is, and with so many trials per candidate."""
    robust = options.definition.with_trials(trials)
    found = {}
    for seed in range(seeds):
        plain = replace(options, seed=seed)
        found[PLAIN, seed] = plain
        found[ROBUST, seed] = replace(plain, definition=robust, risk=CVAR)
    return found


def rollouts(options: TuneOptions) -> int:
    """What a search costs."""
    definition = options.definition
    return definition.population * sum(stage.generations * stage.trials for stage in definition.stages)


def on_unseen_trials(options: TuneOptions, motions: np.ndarray, count: int) -> Score:
    """Scores of motions (M, n), each on the same perturbed trials; NumPy leaves (M, count)."""
    drive = options.drive_for(options.definition.stages[-1].drive)
    evaluation = Evaluation(
        options.perturbed_model, options.definition, drive, options.library, local_mesh(options.devices), CHUNK
    )
    key = jax.random.fold_in(jax.random.key(options.seed), STREAM)
    score = evaluation.scores(crossed(motions, *options.trials(key, count)))
    return jax.tree.map(lambda x: np.asarray(x).reshape(len(motions), count), score)


def figures(found: Mapping[tuple[str, int], TuneOptions], score: Score) -> dict[str, Any]:
    """What each search is worth, and what the robust one gains over the plain one of the same seed."""
    cost = dict(zip(found, np.asarray(score.cost, float), strict=True))
    success = dict(zip(found, score.metrics["success"] > 0.5, strict=True))
    each = [
        {
            "method": method,
            "seed": seed,
            "rollouts": rollouts(options),
            "success_rate": float(success[method, seed].mean()),
            "ci95": list(success_interval(int(success[method, seed].sum()), len(success[method, seed]))),
            "mean_cost": float(cost[method, seed].mean()),
            "cvar_cost": tail_cost(cost[method, seed]),
        }
        for (method, seed), options in found.items()
    ]
    gains = [
        {
            "seed": seed,
            "cvar_cost": paired_difference(cost[PLAIN, seed], cost[ROBUST, seed], tail_cost)._asdict(),
            "mean_cost": paired_difference(cost[PLAIN, seed], cost[ROBUST, seed], np.mean)._asdict(),
            "only_cvar_succeeds": int((success[ROBUST, seed] & ~success[PLAIN, seed]).sum()),
            "only_plain_succeeds": int((success[PLAIN, seed] & ~success[ROBUST, seed]).sum()),
        }
        for seed in dict.fromkeys(seed for _, seed in found)
    ]
    return {"trials": score.cost.shape[1], "tail": 1 - TAIL, "searches": each, "cvar_against_plain": gains}


def tail_cost(costs: np.ndarray) -> float:
    """Mean of the dearest quarter of the trials (N,)."""
    return float(np.sort(costs) @ CVAR.weights(len(costs)))
