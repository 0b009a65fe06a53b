"""`starleth sweep`: many independent searches, on this machine or a cluster, resumable."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from experiments.cli.options import EffectsOption, available_cores, finite
from experiments.cli.search_options import (
    AlphaOption,
    PerturbationsOption,
    PopulationOption,
    RiskOption,
    TrialsOption,
)
from experiments.cli.signals import terminate_as_interrupt
from experiments.errors import UserError

if TYPE_CHECKING:
    from experiments.sweep.definition import Sweep
    from experiments.sweep.executors import Place
    from experiments.sweep.run import Extra

HELP = """Many independent searches: tasks x models x seeds, each a `starleth tune` of its own.

The same command again, or `starleth sweep FOLDER`, goes on with a sweep: finished members are not run again, killed
ones continue from their checkpoints. A member that fails is tried once more, then named; the exit code is 0 only when
all members are finished. `starleth collect FOLDER` puts the results side by side.

    starleth sweep --task squat_jump --seeds 0-7 --output runs/seeds
    starleth sweep sweep.json --output runs/models --workers 4
    starleth sweep sweep.json --output runs/models --executor submitit --workers 64   (pip install 'starleth\\[slurm]')
    starleth sweep sweep.json --output runs/models --executor dask --scheduler tcp://head:8786
    starleth sweep sweep.json --output runs/models --script | sbatch

A sweep file: {"tasks": ["squat_jump"], "seeds": "0-7", "models": ["nominal", "learned.json"], "generations": 100}
"""
FAILED, INTERRUPTED = 1, 130


def register(app: typer.Typer) -> None:
    app.command("sweep", help=HELP)(command)


def command(
    source: Annotated[
        Path | None, typer.Argument(help="A sweep file (.json), or a sweep's folder to go on with.")
    ] = None,
    task: Annotated[list[str] | None, typer.Option(help="A task by name or file; may be repeated.")] = None,
    seeds: Annotated[str | None, typer.Option(help="Seeds: 0-7 or 1,4,9-12. Default: 0.")] = None,
    model: Annotated[list[str] | None, typer.Option(help="A model file, or nominal; may be repeated.")] = None,
    drive: Annotated[
        str | None, typer.Option(help="Drive of the last stages: full (the default), cheap (no current loop) or ideal.")
    ] = None,
    generations: Annotated[int | None, typer.Option(min=1, help="Generations of each search.")] = None,
    population: PopulationOption = None,
    perturbations: PerturbationsOption = None,
    trials: TrialsOption = None,
    risk: RiskOption = None,
    alpha: AlphaOption = None,
    effects: EffectsOption = None,
    executor: Annotated[str, typer.Option(help="local (processes), submitit (SLURM) or dask.")] = "local",
    workers: Annotated[int | None, typer.Option(min=1, max=10_000, help="Members at a time.")] = None,
    devices: Annotated[int, typer.Option(min=1, max=1024, help="Cores of each member.")] = 1,
    scheduler: Annotated[str | None, typer.Option(help="Address of the Dask scheduler; else a local one.")] = None,
    cluster: Annotated[str | None, typer.Option(help="submitit's cluster: slurm or local; else what is there.")] = None,
    hours: Annotated[
        float, typer.Option(min=0.02, max=10_000, callback=finite, help="Time limit of a SLURM job.")
    ] = 24.0,
    script: Annotated[bool, typer.Option("--script", help="Print a script for sbatch and run nothing.")] = False,
    only: Annotated[int | None, typer.Option(min=0, help="Run one member by its number, as --script does.")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Folder of the sweep.")] = None,
) -> None:
    from experiments.sweep.executors import EXECUTORS, Place
    from experiments.sweep.run import Extra

    if executor not in EXECUTORS:
        raise UserError(f"No executor '{executor}'; choose one of {', '.join(EXECUTORS)}.")
    given = {"task": task, "model": model, "seeds": seeds, "drive": drive, "generations": generations}
    given |= {"population": population, "perturbations": perturbations, "trials": trials, "risk": risk, "alpha": alpha}
    folder, sweep = _sweep(source, output, {name: value for name, value in given.items() if value is not None})
    extra = Extra(devices, tuple(effects or ()))
    if only is not None:
        raise typer.Exit(_run_one(folder, sweep, extra, only))
    _refuse_unknown(sweep, extra)
    workers = workers or max(1, available_cores() // devices)
    place = Place(executor, workers, devices, scheduler, cluster, hours)  # type: ignore[arg-type]
    _in_folder(folder, sweep, extra, place, script)


def _in_folder(folder: Path, sweep: "Sweep", extra: "Extra", place: "Place", script: bool) -> None:
    """Run the sweep in its folder, or print the script that does. Raises typer.Exit where members failed."""
    from experiments.run_folder import open_run
    from experiments.sweep.run import array_script, prepare, settings_of

    with open_run(folder, "sweep", settings_of(sweep)) as run:
        prepare(folder)
        if script:
            print(array_script(folder, sweep, extra, place.hours), end="")
            return
        if not _run(folder, sweep, extra, place):
            raise typer.Exit(FAILED)
        run.mark_finished()


def _refuse_unknown(sweep: "Sweep", extra: "Extra") -> None:
    """What every member would refuse for itself, said before there is a folder. Raises UserError."""
    from experiments.effects.library import load_effects
    from experiments.model import load_model
    from experiments.perturbations import perturbations_of_task
    from experiments.sweep.definition import NOMINAL
    from experiments.sweep.member import TUNE
    from experiments.tasks.definition import load_task
    from experiments.tune import parse_risk

    if extra.program != TUNE:
        return
    library = load_effects(extra.effects)
    tasks = [load_task(task).with_options(sweep.generations, sweep.population, sweep.trials) for task in sweep.tasks]
    for task in tasks:
        parse_risk(sweep.risk or "mean", sweep.alpha, task)
    for source in sweep.models:
        model = load_model(None if source == NOMINAL else Path(source), library)
        for task in tasks:
            perturbations_of_task(task, sweep.perturbations, model, library)


def _sweep(source: Path | None, output: Path | None, given: dict[str, Any]) -> "tuple[Path, Sweep]":
    """The sweep's folder and the sweep: one to be gone on with, or a new one. Raises UserError.

    given: what the options say of the sweep, by their names.
    """
    from experiments.sweep.run import sweep_in

    if source is not None and source.is_dir():
        if output is not None or given:
            surplus = _options((*given, *(("output",) if output is not None else ())))
            raise UserError(f"{source} is a sweep already; leave {surplus} away to go on with it.")
        return source, sweep_in(source)
    sweep = _new_sweep(source, given)
    if output is None:
        raise UserError("Where shall the sweep be written? Give a folder with --output.")
    return output, sweep


def _new_sweep(source: Path | None, given: dict[str, Any]) -> "Sweep":
    from experiments.sweep.definition import load_sweep, parse_sweep

    if source is not None:
        if given:
            raise UserError(f"{source} says all of the sweep; leave {_options(given)} away, or write it into the file.")
        return load_sweep(source)
    if "task" not in given:
        raise UserError("Nothing to sweep: give a sweep file, a sweep's folder, or --task.")
    named = {"task": "tasks", "model": "models"}
    content = {named.get(name, name): value for name, value in given.items()}
    return parse_sweep(content, "the sweep").located(Path.cwd())


def _options(names: Iterable[str]) -> str:
    """'--seeds', '--seeds and --drive', '--task, --seeds and --drive'."""
    *others, last = (f"--{name}" for name in names)
    return f"{', '.join(others)} and {last}" if others else last


def _run(folder: Path, sweep: "Sweep", extra: "Extra", place: "Place") -> bool:
    """All members; True when all are finished."""
    from experiments.sweep.executors import open_executor
    from experiments.sweep.run import run_all, unfinished

    members = sweep.members()
    todo, damaged = unfinished(folder, members)
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    failed: dict[str, str] = {}
    with Progress(*columns, console=console) as bar:

        def say(text: str) -> None:
            console.print(text, highlight=False, soft_wrap=True, markup=False)

        drawn = bar.add_task("members", total=len(members), completed=len(members) - len(todo) - len(damaged))
        if len(todo) < len(members):
            say(f"{len(members) - len(todo) - len(damaged)} of {len(members)} members are finished already.")

        def tell(outcome, final: bool) -> None:
            if outcome.exit_code == 0:
                bar.advance(drawn)
            else:
                say(f"{outcome.name}: {outcome.sentence}{'' if final else ' (trying once more)'}")
            if not console.is_terminal and outcome.exit_code == 0:
                say(f"{outcome.name}: finished after {outcome.seconds:.0f} s")

        terminate_as_interrupt()
        try:
            if todo:
                with open_executor(place, folder) as executor:
                    failed = run_all(folder, sweep, todo, extra, executor, tell)
        except KeyboardInterrupt:
            say(f"Interrupted; `starleth sweep {folder}` goes on.")
            raise typer.Exit(INTERRUPTED) from None
        for name, why in (damaged | failed).items():
            say(f"failed: {name}: {why}")
        done = len(members) - len(damaged) - len(failed)
        say(f"{done} of {len(members)} members are finished; `starleth collect {folder}` compares them.")
    return not failed and not damaged


def _run_one(folder: Path, sweep: "Sweep", extra: "Extra", number: int) -> int:
    """One member, as a task of a SLURM array; its exit code."""
    from experiments.sweep.member import result_of, run_member
    from experiments.sweep.run import job_of, prepare, sweep_in

    if sweep_in(folder) != sweep.model_copy(update={"about": ""}):
        raise UserError(f"{folder} holds another sweep; run its members with `starleth sweep {folder} --only N`.")
    members = sweep.members()
    if number >= len(members):
        raise UserError(f"No member {number}; the sweep has the members 0 to {len(members) - 1}.")
    prepare(folder)
    if result_of(folder, members[number].name) is not None:
        typer.echo(f"{members[number].name} is finished already.", err=True)
        return 0
    terminate_as_interrupt()
    try:
        outcome = run_member(job_of(folder, sweep, members[number], extra))
    except KeyboardInterrupt:
        return INTERRUPTED
    if outcome.exit_code:
        typer.echo(f"{outcome.name}: {outcome.sentence}", err=True)
    return FAILED if outcome.exit_code < 0 else outcome.exit_code
