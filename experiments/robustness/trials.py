"""`starleth robustness`: one motion under thousands of perturbed trials, in blocks that survive an interruption.

A trial is known by seed and index: whatever else is run, on however many devices, it draws the same numbers and
comes to the same bits. So one trial can be run again alone.
"""

import heapq
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np

from experiments.batch import CHUNK, local_mesh
from experiments.effects.effect import Effect
from experiments.effects.library import LIBRARY
from experiments.evaluation import Evaluation, Members, crossed
from experiments.export import versions
from experiments.model import Model
from experiments.perturbations import Perturbations, describe
from experiments.robustness.margins import MARGIN_UNITS, with_margins
from experiments.robustness.statistics import distribution, influence, success_interval, survival
from experiments.robustness.store import DRAWN, Table, TrialStore, blocks
from experiments.run_folder import RunFolder
from experiments.tasks.definition import TaskDefinition
from experiments.tasks.registry import metric_units

STREAM = 104_729  # these trials are not those that the search or its judging has seen
WORST = 10
SAMPLE = 16_384  # trials held in memory at once, whatever their number
# Disturbances with a direction: what counts is their size.
VECTORS = {"push": ("push_x", "push_y"), "slope": ("slope_x", "slope_y")}


@dataclass(frozen=True)
class RobustnessOptions:
    """What is tried, on what, how often."""

    values: np.ndarray = field(hash=False)  # (n,)
    definition: TaskDefinition
    model: Model
    drive: str
    perturbations: Perturbations
    seed: int
    trials: int
    parameters: str  # checksum of the parameter file
    library: Mapping[str, Effect] = field(default_factory=lambda: LIBRARY, hash=False)
    devices: int | None = None

    def settings(self) -> dict[str, Any]:
        """What decides the result, as JSON values; more trials continue the same run."""
        return {
            "parameters": self.parameters,
            "task": self.definition.model_dump(mode="json"),
            "model": self.model.hash(),
            "drive": self.drive,
            "seed": self.seed,
            "trials": self.trials,
            "perturbations": self.perturbations.model_dump(mode="json")["draw"],
            "versions": versions(),
        }


class PerturbedTrials:
    """The motion of the options, compiled once, for any of its trials."""

    def __init__(self, options: RobustnessOptions) -> None:
        self.options = options
        self.key = jax.random.fold_in(jax.random.key(options.seed), STREAM)

    @cached_property
    def evaluation(self) -> Evaluation:
        o = self.options
        mesh = local_mesh(o.devices)
        model = o.perturbations.on(o.model, o.library)
        return Evaluation(model, o.definition, o.drive, o.library, mesh, CHUNK, watched=with_margins)

    def members(self, first: int, count: int) -> Members:
        """So many trials from an index on."""
        numbers, noise = self.options.perturbations.columns(self.key, count, first)
        return crossed(self.options.values[None], numbers, noise)

    def run(self, first: int, count: int) -> Table:
        """Run them: what was drawn, the cost, the metrics, one row each."""
        members = self.members(first, count)
        score = self.evaluation.scores(members)
        drawn = {f"{DRAWN}{name}": values for name, values in members.numbers.items()}
        table = {"trial": np.arange(first, first + count), **drawn, "cost": score.cost}
        return table | {name: score.metrics[name] for name in self.units}

    def alone(self, index: int) -> dict[str, np.generic]:
        """One trial's row, from the chunk that it has its place in: the last bit depends on the place in the vector."""
        chunk = self.evaluation.members_per_chunk
        first = index - index % chunk
        return {name: column[index - first] for name, column in self.run(first, chunk).items()}

    @cached_property
    def units(self) -> dict[str, str]:
        """Units of the metrics, margins included."""
        return {**metric_units(self.options.definition.task), **MARGIN_UNITS}

    @property
    def columns(self) -> tuple[str, ...]:
        """Of a table, in order."""
        return ("trial", *(f"{DRAWN}{name}" for name in self.options.perturbations.names), "cost", *self.units)


class Outcome(NamedTuple):
    """All trials, summed up in bounded memory."""

    trials: int
    successes: int
    worst: list[dict[str, float]]  # rows, failures first, then the dearest
    sample: Table  # the first SAMPLE trials


def run_trials(
    trials: PerturbedTrials, run: RunFolder, on_block: Callable[[int, int], None], notify: Callable[[str], None]
) -> Outcome:
    """All trials of the options; finished blocks of an earlier process are taken as they are. Raises UserError.

    `on_block(done, successes)` after every block.
    """
    store = TrialStore(run.path, notify)
    done = successes = 0
    worst: list[tuple] = []
    sample: list[Table] = []
    for first, count in blocks(trials.options.trials):
        table = store.get(first, count, trials.columns)
        if table is None:
            table = trials.run(first, count)
            store.put(first, table)
        if done < SAMPLE:
            sample.append(table)
        done, successes = done + count, successes + int((table["success"] > 0.5).sum())
        rows = range(count)
        ranked = ((_badness(table, i), {name: float(x[i]) for name, x in table.items()}) for i in rows)
        worst = heapq.nlargest(WORST, [*worst, *ranked], key=lambda item: item[0])
        on_block(done, successes)
    whole = {name: np.concatenate([part[name] for part in sample]) for name in trials.columns}
    return Outcome(done, successes, [row for _, row in worst], whole)


def _badness(table: Table, i: int) -> tuple[bool, float, int]:
    return bool(table["success"][i] < 0.5), float(table["cost"][i]), -int(table["trial"][i])


def summary(trials: PerturbedTrials, outcome: Outcome, command: str) -> dict[str, Any]:
    """The statistics of `robustness.json`; `command` is the one that is being run."""
    o, sample = trials.options, outcome.sample
    standing = sample["success"] > 0.5
    watched = standing if standing.any() else ~standing  # a robot that fell has no margins worth knowing
    low, high = success_interval(outcome.successes, outcome.trials)
    return {
        "trials": outcome.trials,
        "successes": outcome.successes,
        "success_rate": outcome.successes / outcome.trials,
        "ci95": [low, high],
        "worst": [describe_trial(trials, row, command) for row in outcome.worst],
        "sensitivity": _sensitivity(o, sample),
        "margins": {name: _spread(unit, sample[name][watched]) for name, unit in MARGIN_UNITS.items()},
        "metrics": {
            n: _spread(u, sample[n]) for n, u in ({"cost": "1"} | trials.units).items() if n not in MARGIN_UNITS
        },
        "survival": [_curve(name, unit, x, sample["success"]) for name, unit, x in _disturbances(o, sample)],
        "sampled": len(sample["trial"]),
    }


def describe_trial(trials: PerturbedTrials, row: Mapping[str, float], command: str) -> dict[str, Any]:
    """One row of a table, as it stands in `robustness.json`."""
    trial = int(row["trial"])
    return {
        "trial": trial,
        "seed": trials.options.seed,
        "success": bool(row["success"] > 0.5),
        "cost": float(row["cost"]),
        "drawn": {n.removeprefix(DRAWN): float(x) for n, x in row.items() if n.startswith(DRAWN)},
        "metrics": {name: float(row[name]) for name in trials.units},
        "command": f"{command} --only {trial}",
    }


def _spread(unit: str, values: np.ndarray) -> dict[str, Any]:
    return {"unit": unit, **distribution(values)._asdict()}


def _sensitivity(options: RobustnessOptions, sample: Table) -> list[dict[str, Any]]:
    found = []
    for name in options.perturbations.names:
        effect = influence(sample[DRAWN + name], sample["cost"])
        if effect is not None:
            unit = describe(name, options.model, options.library).unit
            found.append({"name": name, "unit": unit, **effect._asdict()})
    return sorted(found, key=lambda item: -item["share"])


def _disturbances(options: RobustnessOptions, sample: Table) -> list[tuple[str, str, np.ndarray]]:
    """Name, unit and size of everything drawn that varies; a vector counts by its length."""
    drawn = {name: sample[DRAWN + name] for name in options.perturbations.names}
    found = []
    for name, parts in VECTORS.items():
        if all(part in drawn for part in parts):
            unit = describe(parts[0], options.model, options.library).unit
            found.append((name, unit, np.hypot(*(drawn.pop(part).astype(float) for part in parts))))
    found += [(name, describe(name, options.model, options.library).unit, x) for name, x in drawn.items()]
    return [item for item in found if np.ptp(item[2]) > 0]


def _curve(name: str, unit: str, values: np.ndarray, success: np.ndarray) -> dict[str, Any]:
    s = survival(values, success)
    return {
        "name": name,
        "unit": unit,
        "edges": s.edges.astype(float).tolist(),
        "trials": s.trials.tolist(),
        "successes": s.successes.tolist(),
        "ci95": [[float(a), float(b)] for a, b in zip(s.low, s.high, strict=True)],
    }
