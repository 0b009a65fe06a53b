"""The benchmark of the gaits as one job: every gait's figures, as one record each."""

from collections.abc import Callable, Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from experiments.effects.library import LIBRARY
from experiments.errors import UserError
from experiments.gait_benchmark.disturbances import SWEEPS, Sweep, drawn, nominal, swept
from experiments.gait_benchmark.trials import GaitTrials, Outcome, cases, gait_settings, joined
from experiments.model import Model
from experiments.recording import gait_record
from experiments.replay import Motion, load_motion, replay
from experiments.reports.recording import GaitRecord
from experiments.robustness.statistics import success_interval
from experiments.tasks.registry import GAITS


class Plan(NamedTuple):
    """What is to be measured."""

    motions: Sequence[Motion]
    trials: int  # unseen ones of each gait and of its initial guess
    cycles: int
    sweep_trials: int  # at each size of each disturbance
    mujoco_c: bool
    seed: int  # of the trials


class GaitResult(NamedTuple):
    """One gait: its figures as JSON values, and its motion in MuJoCo C to look at."""

    figures: dict[str, Any]
    record: GaitRecord | None


def find_motions(names: Sequence[str], model: Model, task: str | None = None) -> list[Motion]:
    """Gaits by name (the examples that come with the program) or parameter files.

    task: the user's own task file, if all of them were tuned with it. Raises UserError.
    """
    examples = resources.files("experiments") / "examples"
    known = [name for name in GAITS if (examples / f"{name}.json").is_file()]
    motions = []
    for name in names or known:
        path = Path(str(examples / f"{name}.json")) if name in known else Path(name)
        if name not in known and not path.exists():
            raise UserError(f"No gait '{name}': give {', '.join(known)}, a run's folder or a parameters.json.")
        motion = load_motion(path, model, task)
        if motion.definition.task not in GAITS:
            raise UserError(f"{name} is a {motion.definition.task}, not a gait; the gaits are {', '.join(GAITS)}.")
        motions.append(motion)
    return motions


def measure(plan: Plan, model: Model, devices: int | None, say: Callable[[str], None]) -> Iterator[GaitResult]:
    """Every gait in turn."""
    trials = GaitTrials(model, plan.motions[0].definition, devices)
    for motion in plan.motions:
        yield _one(plan, motion, model, trials, say)


def _one(plan: Plan, motion: Motion, model: Model, trials: GaitTrials, say: Callable[[str], None]) -> GaitResult:
    definition, stride = motion.definition, motion.file.values()["cycle_duration"]
    guess = definition.space().initial
    found, first = (gait_settings(definition, model, values) for values in (motion.values, guess))
    start = float(found.controller.start.stand) + float(found.controller.start.blend)
    duration = start + plan.cycles * stride
    # a gait's speed wanders from stride to stride: two engines are compared over as many of them as the trials have
    undisturbed = definition.model_copy(update={"duration": max(duration, definition.duration)})
    guess_stride = definition.space().named(guess)["cycle_duration"]
    draws = drawn(definition, model, plan.trials, plan.seed)
    parts = [
        cases(found, *draws, duration),
        cases(first, *draws, start + plan.cycles * guess_stride),
        cases(found, *nominal(definition, model), undisturbed.duration),
        *(
            swept(sweep, definition, model, found, stride, plan.sweep_trials, plan.seed)
            for sweep in SWEEPS
            if plan.sweep_trials
        ),
    ]
    outcomes = _split(trials.run(joined(parts)), [len(part) for part in parts])
    unseen, guessed, alone = outcomes[:3]
    figures = {
        "gait": definition.task,
        "stride": round(float(stride), 4),
        "cycles": plan.cycles,
        "seed": plan.seed,
        "trials": plan.trials,
        "survived": int(unseen.survived.sum()),
        "survived_interval": _interval(unseen.survived),
        "initial_guess_survived": int(guessed.survived.sum()),
        "speed_commanded": round(float(found.command.heading), 4),
        "speed_reached": _mean(unseen.speed[:, 0], unseen.survived),
        "flight_fraction": _mean(unseen.flight_fraction, unseen.survived),
        "flight_duration": _mean(unseen.flight_duration, unseen.survived),
        "flights_per_stride": _mean(unseen.flights * stride, unseen.survived),
        "nominal_speed": round(float(alone.speed[0, 0]), 4),
        "sweeps": [_curve(s, o, plan.sweep_trials) for s, o in zip(SWEEPS, outcomes[3:], strict=False)],
    }
    say(f"{definition.task}: {figures['survived']} of {plan.trials} survive {plan.cycles} cycles")
    record = None
    if plan.mujoco_c:
        score, ticks = replay(motion.values, undisturbed, model, "full", "mujoco_c", dict(LIBRARY))
        speed = float(score.metrics["heading_speed"])
        ratio = speed / figures["nominal_speed"] if figures["nominal_speed"] else float("nan")
        survived = bool(score.metrics["survived"] > 0.5)
        figures["mujoco_c"] = {"survived": survived, "speed": round(speed, 4), "speed_ratio": round(ratio, 4)}
        shown = int(np.searchsorted(ticks.time, definition.duration))
        record = gait_record(jax.tree.map(lambda x: x[:shown], ticks), "full")
        say(f"{definition.task}: in MuJoCo C {'no fall' if survived else 'a FALL'}, {100 * ratio:.0f} % of the speed")
    return GaitResult(figures, record)


def _split(outcome: Outcome, counts: Sequence[int]) -> list[Outcome]:
    ends = np.cumsum(counts)
    return [jax.tree.map(lambda x, a=end - n, b=end: x[a:b], outcome) for n, end in zip(counts, ends, strict=True)]


def _curve(sweep: Sweep, outcome: Outcome, trials: int) -> dict[str, Any]:
    survived = outcome.survived.reshape(len(sweep.levels), trials)
    points = [
        {"level": level, "trials": trials, "survived": int(row.sum()), "interval": _interval(row)}
        for level, row in zip(sweep.levels, survived, strict=True)
    ]
    return {"disturbance": sweep.name, "unit": sweep.unit, "asked": sweep.asked, "points": points}


def _interval(survived: np.ndarray) -> list[float]:
    return [round(x, 4) for x in success_interval(int(survived.sum()), len(survived))]


def _mean(values: np.ndarray, survived: np.ndarray) -> float | None:
    """Over the trials without a fall; None where there is nothing to average."""
    good = values[(survived > 0.5) & np.isfinite(values)]
    return round(float(good.mean()), 4) if len(good) else None
