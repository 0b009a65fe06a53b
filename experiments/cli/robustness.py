"""`starleth robustness`: thousands of perturbed trials of a tuned motion."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from experiments.cli.options import (
    DevicesOption,
    EffectsOption,
    ModelOption,
    SeedOption,
    available_cores,
    finite,
    start_jax,
    whole_loops,
)
from experiments.cli.signals import terminate_as_interrupt

if TYPE_CHECKING:  # JAX must not start before its devices are set
    from experiments.robustness.analysis import Plan
    from experiments.robustness.file import RobustnessFile

HELP = """Try a tuned motion under thousands of perturbations and say how often it succeeds.

Every trial draws masses, friction, springs, motors, delays, sensor noise and bias, pushes, slopes, obstacles and
battery voltage from the laws in a readable file. It leaves in the output folder: robustness.json, report.html, and
every trial as a table (trials/*.parquet). A trial is known by its seed and index and can be run again alone.

The perturbations: rough (the default), well_kept (what tune judges with), or your own file, in the form of these.

Ctrl-C leaves the finished trials; the same command continues, also with more --trials.

    starleth robustness runs/squat_jump
    starleth robustness runs/squat_jump --trials 20000 --perturbations my_perturbations.json
    starleth robustness runs/squat_jump --only 137 --output trial_137    one trial alone, to look at
    starleth robustness runs/squat_jump --gate 0.99    writes a parameters.json with the verdict for the robot
"""
GATE_FAILED = 1


def register(app: typer.Typer) -> None:
    app.command("robustness", help=HELP)(command)


def command(
    source: Annotated[Path, typer.Argument(help="A run's folder or a parameters.json.")],
    trials: Annotated[int, typer.Option(min=1, max=100_000_000, help="Perturbed trials.")] = 4096,
    perturbations: Annotated[str, typer.Option(help="rough, well_kept, or a perturbation file.")] = "rough",
    model: ModelOption = None,
    effects: EffectsOption = None,
    task: Annotated[str | None, typer.Option(help="Your own task file, if it was tuned with one.")] = None,
    drive: Annotated[str | None, typer.Option(help="full, cheap or ideal. Default: the one it was tuned on.")] = None,
    seed: SeedOption = 0,
    devices: DevicesOption = available_cores(),  # noqa: B008
    only: Annotated[
        int | None, typer.Option(min=0, max=100_000_000, help="Run just the trial of this index; print it as JSON.")
    ] = None,
    gate: Annotated[
        float | None,
        typer.Option(min=0, max=1, callback=finite, help="Success rate that is required, with 95 % confidence."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder of the results. Default: beside the parameters.")
    ] = None,
) -> None:
    terminate_as_interrupt()
    whole_loops()
    start_jax(devices)
    from experiments.command_line import command_line
    from experiments.effects.library import load_effects
    from experiments.files import json_line
    from experiments.model import load_model
    from experiments.perturbations import load_perturbations
    from experiments.robustness import analysis

    library = load_effects(effects or ())
    robot = load_model(model, library)
    laws = load_perturbations(perturbations, robot, library)
    given = {"--seed": seed, "--perturbations": perturbations, "--model": model, "--task": task, "--drive": drive}
    line = command_line(("robustness", source), given | {"--effects": effects})
    plan = analysis.plan(source, robot, laws, trials, seed, line, task, drive, library, devices, gate)
    _say_other_model(plan)
    if only is not None:
        print(json_line(analysis.one_trial(plan, only, output)))
        return
    found = _analysed(plan, output or (source if source.is_dir() else source.parent) / "robustness")
    if found.gate is not None and not found.gate.passed:
        raise typer.Exit(GATE_FAILED)


def _analysed(plan: "Plan", folder: Path) -> "RobustnessFile":
    """All trials in their folder, or those that it lacks. Raises UserError."""
    from experiments.cli.robustness_progress import RobustnessProgress
    from experiments.robustness.analysis import analyse
    from experiments.run_folder import open_run

    with (
        open_run(folder, "robustness", plan.options.settings(), may_differ=("trials",)) as run,
        RobustnessProgress(plan.options.trials, folder) as progress,
    ):
        found = analyse(plan, run, progress.update, progress.say)
        progress.finish(found)
        run.mark_finished()
    return found


def _say_other_model(plan: "Plan") -> None:
    """The figures of a motion on a model that it was not tuned on are easily taken for those of its own."""
    tuned_on, model = plan.file.model_hash, plan.options.model.hash()
    if tuned_on != model:
        typer.echo(
            f"The motion was tuned on the model {tuned_on} and is tried on {model}; give the model it was tuned on by "
            "--model if that is not what you want.",
            err=True,
        )
