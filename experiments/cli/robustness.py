"""`starleth robustness`: thousands of perturbed trials of a tuned motion."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

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
    from experiments.cli.robustness_progress import RobustnessProgress
    from experiments.effects.library import load_effects
    from experiments.files import json_line
    from experiments.model import load_model
    from experiments.perturbations import load_perturbations
    from experiments.robustness import analysis
    from experiments.run_folder import open_run

    library = load_effects(effects or ())
    robot = load_model(model, library)
    laws = load_perturbations(perturbations, robot, library)
    given = {"--perturbations": perturbations, "--model": model, "--task": task, "--drive": drive}
    line = _line(source, seed, given, effects or ())
    plan = analysis.plan(source, robot, laws, trials, seed, line, task, drive, library, devices, gate)
    if only is not None:
        print(json_line(analysis.one_trial(plan, only, output)))
        return
    folder = output or (source if source.is_dir() else source.parent) / "robustness"
    with (
        open_run(folder, "robustness", plan.options.settings(), may_differ=("trials",)) as run,
        RobustnessProgress(trials, folder) as progress,
    ):
        found = analysis.analyse(plan, run, progress.update, progress.say)
        progress.finish(found)
        run.mark_finished()
    if found.gate is not None and not found.gate.passed:
        raise typer.Exit(GATE_FAILED)


def _line(source: Path, seed: int, given: Mapping[str, object], effects: Sequence[Path]) -> str:
    """The command that runs the same trials again, for the files that they leave."""
    words = [str(source), "--seed", str(seed), *(w for k, v in given.items() if v is not None for w in (k, str(v)))]
    words += [w for path in effects for w in ("--effects", str(path))]
    return shlex.join(["starleth", "robustness", *words])
