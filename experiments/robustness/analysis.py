"""From a tuned motion's file to its robustness analysis on disk: what the command line calls."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np
from pydantic import ValidationError

from experiments.effects.effect import Effect
from experiments.errors import UserError
from experiments.export import ROBOT, versions
from experiments.files import first_complaint, nan_as_null, shown, write_json
from experiments.model import Model
from experiments.parameter_file import gate, now, parameters_at, read_parameters, write_parameters
from experiments.parameter_schema import ParameterFile
from experiments.perturbations import Perturbations
from experiments.recording import until_divergence
from experiments.reports.robustness import write_robustness_report
from experiments.reports.robustness_trial import write_trial_report
from experiments.robustness.file import RobustnessFile
from experiments.robustness.trials import PerturbedTrials, RobustnessOptions, describe_trial, run_trials, summary
from experiments.run_folder import RunFolder, make_answer_folder
from experiments.tasks.definition import task_of
from experiments.trial import Trial, noise_table
from sea_jax import DRIVES


@dataclass(frozen=True)
class Plan:
    """What the user asked for."""

    options: RobustnessOptions
    file: ParameterFile  # of the motion
    command: str
    required: float | None  # success rate of the gate

    @cached_property
    def trials(self) -> PerturbedTrials:
        """The options' trials, compiled at the first use."""
        return PerturbedTrials(self.options)


def plan(
    source: Path,
    model: Model,
    perturbations: Perturbations,
    trials: int,
    seed: int,
    command: str,
    task: str | None,
    drive: str | None,
    library: Mapping[str, Effect],
    devices: int | None,
    required: float | None,
) -> Plan:
    """Read the motion and put the analysis together. Raises UserError."""
    path = parameters_at(source)
    file = read_parameters(path, robot=ROBOT, allow_ungated=True)
    if model.numbers is None:
        raise UserError(
            "This model is a single joint on a bench: it has no legs to try a motion on; give a model of the robot."
        )
    if required is not None and file.model_hash != model.hash():
        raise UserError(
            f"{shown(path)} was tuned on the model {file.model_hash}, not on {model.hash()}: a gate speaks for the "
            "model it was tuned on; give that model file, or leave --gate away."
        )
    definition = task_of(file, path, task)
    if drive is not None and drive not in DRIVES:
        raise UserError(f"No drive '{shown(drive)}'; choose one of {', '.join(DRIVES)}.")
    if required is not None and drive not in (None, file.drive):
        raise UserError(f"A gate speaks for the drive that the motion was tuned on, {file.drive}; leave --drive away.")
    options = RobustnessOptions(
        values=definition.space().vector(file.values()),
        definition=definition,
        model=model,
        drive=drive or file.drive,
        perturbations=perturbations,
        seed=seed,
        trials=trials,
        parameters=file.checksum,
        library=library,
        devices=devices,
    )
    return Plan(options, file, command, required)


def analyse(
    plan: Plan, run: RunFolder, on_block: Callable[[int, int], None], notify: Callable[[str], None]
) -> RobustnessFile:
    """Run all trials; write robustness.json, report.html, and parameters.json if a gate was asked for."""
    o, trials = plan.options, plan.trials
    outcome = run_trials(trials, run, on_block, notify)
    laws = {name: law.model_dump_json() for name, law in o.perturbations.draw.items()}
    verdict = None
    if plan.required is not None:
        verdict = gate(plan.required, outcome.successes, outcome.trials, o.seed, laws)
    found = _checked(
        run.path,
        task=o.definition.task,
        robot=ROBOT,
        model_hash=o.model.hash(),
        tuned_on=plan.file.model_hash,
        parameters=plan.file.checksum,
        drive=o.drive,
        seed=o.seed,
        gate=verdict,
        perturbations=laws,
        versions=versions(),
        created=now(),
        command=f"{plan.command} --trials {outcome.trials}",
        **summary(trials, outcome, plan.command),
    )
    write_json(run / "robustness.json", found.model_dump(mode="json"))
    write_robustness_report(run / "report.html", found, outcome.sample)
    if verdict is not None:
        fields = {name: getattr(plan.file, name) for name in ParameterFile.model_fields}
        for name in ("schema_version", "checksum"):
            fields.pop(name)
        write_parameters(run / "parameters.json", **fields | {"robustness_gate": verdict})
    return found


def _checked(folder: Path, **fields: Any) -> RobustnessFile:
    try:
        return RobustnessFile(**fields)
    except ValidationError as error:
        raise UserError(
            f"{shown(folder)}/robustness.json was not written: {first_complaint(error)}; the trials are in "
            f"{shown(folder)}/trials."
        ) from None


def one_trial(plan: Plan, index: int, output: Path | None) -> dict[str, Any]:
    """One trial alone, to the bits it had among the others; with `output`, a report with its motion."""
    trials = plan.trials
    if output is not None:
        make_answer_folder(output)
    answer = describe_trial(trials, trials.alone(index), plan.command)
    if output is not None:
        write_json(output / "trial.json", nan_as_null(answer))
        evaluation, members = trials.evaluation, trials.members(index, 1)
        trial = Trial({n: x[0] for n, x in members.numbers.items()}, noise_table(), members.noise_start[0])
        params, settings = evaluation.limited()
        record = jax.jit(evaluation.rollout.record)
        _, ticks = jax.tree.map(np.asarray, record(params, settings, members.values[0], trial))
        ticks = until_divergence(ticks)
        terrain = jax.tree.map(np.asarray, trial.apply(evaluation.rollout.plant, params).bodies.terrain)
        write_trial_report(output / "report.html", plan.file, answer, trials.units, ticks, terrain, plan.options.model)
    return answer
