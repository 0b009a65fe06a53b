"""What a tuned motion leaves behind: the robot's parameter file, the motion, the report."""

from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from es import SearchResult
from experiments.command_line import command_line
from experiments.parameter_file import gate, now, parameter, write_parameters
from experiments.parameter_schema import Metric, PerturbedTrials, Spread
from experiments.recording import gait_record, jump_record, write_motion
from experiments.reports.gait import write_gait_report
from experiments.reports.jump import write_jump_report
from experiments.reports.recording import History, Recording
from experiments.robustness.statistics import success_interval
from experiments.rollout import Score
from experiments.run_folder import RunFolder
from experiments.tasks.registry import GAITS, metric_units
from experiments.trial import Trial, noise_table

if TYPE_CHECKING:
    from experiments.refinement import Refinement
    from experiments.tune import StagedEvaluation, TuneOptions

ROBOT = "starleth"


class Judged(NamedTuple):
    """The chosen candidate and how it did."""

    values: np.ndarray  # (n,)
    nominal: Score  # NumPy scalars
    trials: Score  # leaves (K,)
    numbers: dict[str, np.ndarray]  # (K,) what was perturbed
    required: float  # success rate of the robustness gate

    @property
    def successes(self) -> int:
        """Of the perturbed trials."""
        return int((self.trials.metrics["success"] > 0.5).sum())

    @property
    def at_least(self) -> float:
        """Success rate that they show with 95 % confidence."""
        return success_interval(self.successes, len(self.trials.cost))[0]

    @property
    def passed(self) -> bool:
        """Whether that is the required one."""
        return self.at_least >= self.required


def export(
    options: "TuneOptions",
    evaluation: "StagedEvaluation",
    run: RunFolder,
    result: SearchResult,
    judged: Judged,
    refinement: "Refinement | None" = None,
) -> None:
    """Write parameters.json, motion.npz and report.html of a finished search or refinement. Raises UserError."""
    drive = evaluation.on(options.definition.stages[-1].drive).drive
    fields = parameter_fields(options, drive, run.path, result, judged)
    if refinement is not None:
        fields["search"] |= refinement_fields(refinement)
    file = write_parameters(run / "parameters.json", **fields)
    jump = options.definition.task not in GAITS
    with ThreadPoolExecutor() as pool:  # compiling is most of it: side by side
        beside = pool.submit(record_motion, evaluation, "ideal", judged.values) if jump else None
        record = record_motion(evaluation, drive, judged.values)
    write_motion(run / "motion.npz", record)
    history = History(
        best=np.array([g.best_cost for g in result.history]),
        mean=np.array([g.mean_cost for g in result.history]),
        sigma=np.array([g.sigma for g in result.history]),
        stage=np.array([g.stage for g in result.history]),
        stage_names=[stage.name for stage in options.definition.stages],
        population=options.definition.population,
    )
    report, numbers = run / "report.html", options.model.numbers
    shown = history if result.history else None
    if beside is None:
        write_gait_report(report, file, numbers, record, history=shown)
    else:
        course = None if refinement is None else refinement.found.course
        write_jump_report(report, file, numbers, record, ideal=beside.result(), history=shown, refinement=course)


def refinement_fields(refinement: "Refinement") -> dict[str, Any]:
    """What the parameter file says about a refinement."""
    found = refinement.found
    return {
        "refine_steps": len(found.history),
        "refine_cost_before": found.initial_cost,
        "refine_cost_after": found.best_cost,
        "refine_kept": refinement.kept,
    }


def record_motion(evaluation: "StagedEvaluation", drive: str, values: np.ndarray) -> Recording:
    """The nominal trial of a candidate, tick by tick, on one drive."""
    on = evaluation.on(drive)
    params, settings = on.limited()
    numbers, noise_start = evaluation.options.nominal()
    trial = Trial({name: column[0] for name, column in numbers.items()}, noise_table(), noise_start[0])
    _, ticks = jax.jit(on.rollout.record)(params, settings, np.asarray(values, np.float32), trial)
    record = gait_record if on.definition.task in GAITS else jump_record
    return record(jax.tree.map(np.asarray, ticks), drive)


def parameter_fields(
    options: "TuneOptions", drive: str, folder: Path, result: SearchResult, judged: Judged
) -> dict[str, Any]:
    """The contents of the parameter file."""
    definition = options.definition
    space = definition.space()
    named = space.named(judged.values)
    trials = len(judged.trials.cost)
    laws = {name: law.model_dump_json() for name, law in options.perturbations.draw.items()}
    return {
        "task": definition.task,
        "task_hash": definition.hash(),
        "robot": ROBOT,
        "model_hash": options.model.hash(),
        "parameters": [parameter(p.name, named[p.name], p.unit, p.low, p.high) for p in definition.parameters],
        "metrics": metrics(definition.task, judged),
        "cost_terms": {name: float(value) for name, value in judged.nominal.terms.items()},
        "perturbed": PerturbedTrials(
            trials=trials,
            seed=options.seed,
            perturbations=laws,
        ),
        "robustness_gate": gate(judged.required, judged.successes, trials, options.seed, laws),
        "drive": drive,
        "seed": options.seed,
        "search": {
            "generations": len(result.history),
            "population": definition.population,
            "evaluations": result.evaluations,
            "stages": ", ".join(f"{s.name} ({s.generations})" for s in result.stages),
        },
        "versions": versions(),
        "created": now(),
        "command": replay_line(options, folder),
    }


def replay_line(options: "TuneOptions", folder: Path) -> str:
    """The command that replays what a search leaves in its folder. Raises UserError where it is too long to be kept."""
    return command_line(("replay", folder), options.files)


def metrics(task: str, judged: Judged) -> dict[str, Metric]:
    """Metrics of the nominal trial, with their spread over the perturbed ones."""
    found = {"cost": _metric("", judged.nominal.cost, judged.trials.cost)}
    for name, unit in metric_units(task).items():
        found[name] = _metric(unit, judged.nominal.metrics[name], judged.trials.metrics[name])
    return found


def _metric(unit: str, value: np.ndarray, spread: np.ndarray) -> Metric:
    values = np.asarray(spread, float)
    summary = Spread(
        mean=float(values.mean()), std=float(values.std()), low=float(values.min()), high=float(values.max())
    )
    shown: bool | float = bool(value > 0.5) if unit == "bool" else float(value)
    return Metric(value=shown, unit="-" if unit in ("bool", "") else unit, spread=summary)


def versions() -> dict[str, str]:
    """The packages whose version may change a number."""
    return {name: version(name) for name in ("starleth", "jax", "jaxlib", "mujoco", "mujoco-mjx", "evosax", "numpy")}
