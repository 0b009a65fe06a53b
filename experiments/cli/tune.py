"""`starleth tune`: search a motion in simulation and leave a parameter file for the robot."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from experiments.cli.options import (
    DevicesOption,
    EffectsOption,
    ModelOption,
    SeedOption,
    available_cores,
    start_jax,
    whole_loops,
)
from experiments.cli.search_options import (
    AlphaOption,
    CoordinatorOption,
    DistributedOption,
    DriveOption,
    GenerationsOption,
    PerturbationsOption,
    PopulationOption,
    ProcessesOption,
    ProcessOption,
    RefineOption,
    RiskOption,
    RunFolderOption,
    StartOption,
    TaskArgument,
    TrialsOption,
)
from experiments.cli.signals import terminate_as_interrupt
from experiments.errors import UserError

if TYPE_CHECKING:  # JAX must not start before its devices are set
    from experiments.tasks.definition import TaskDefinition
    from experiments.tune import TuneOptions

HELP = """Search a motion in simulation and leave a parameter file for the robot.

The search runs CMA-ES through the task's stages (perfect torque first, the full drive train last), all candidates of a
generation in parallel on all cores. It leaves in the output folder: parameters.json for the robot's controller,
report.html to look at, motion.npz to replay.

Ctrl-C and SIGTERM leave a resumable run: the same command continues it, to the same result to the bit.

--distributed: several processes, on one machine or many, search one population; the result is the same to the bit.

    starleth tune squat_jump
    starleth tune running_trot        or walking_trot, lateral_walk, bound, pronk
    starleth tune squat_jump --generations 100 --seed 3 --output runs/jump3
    starleth tune squat_jump --model learned_model.json --start runs/squat_jump     the same jump for a better model
    starleth tune squat_jump --trials 8 --risk cvar     good in the worst quarter of 8 perturbed trials each
    starleth tune squat_jump --refine 40               then downhill by gradients; also on a finished run
    starleth tune squat_jump --generations 0 --refine 40     by gradients alone, from the initial guess

--refine takes slopes from a smooth approximation of the rollout (a jump up to touch-down, a gait's first strides), and
steps that lower the true cost.
"""


def register(app: typer.Typer) -> None:
    app.command("tune", help=HELP)(command)


def command(
    task: TaskArgument,
    model: ModelOption = None,
    start: StartOption = None,
    drive: DriveOption = "full",
    generations: GenerationsOption = None,
    population: PopulationOption = None,
    trials: TrialsOption = None,
    risk: RiskOption = None,
    alpha: AlphaOption = None,
    refine: RefineOption = 0,
    seed: SeedOption = 0,
    devices: DevicesOption = available_cores(),  # noqa: B008
    output: RunFolderOption = None,
    perturbations: PerturbationsOption = None,
    effects: EffectsOption = None,
    distributed: DistributedOption = False,
    coordinator: CoordinatorOption = None,
    processes: ProcessesOption = None,
    process: ProcessOption = None,
) -> None:
    terminate_as_interrupt()
    whole_loops()
    start_jax(devices)
    _meet_others(distributed, coordinator, processes, process)
    from experiments.effects.library import load_effects
    from experiments.model import load_model
    from experiments.perturbations import perturbations_of_search, perturbations_of_task
    from experiments.tune import TuneOptions, parse_risk

    library = load_effects(effects or ())
    definition = _definition(task, start, drive, generations, population, trials, refine)
    robot = load_model(model, library)
    options = TuneOptions(
        definition,
        robot,
        seed,
        perturbations_of_task(definition, perturbations, robot, library),
        drive,
        parse_risk(risk or "mean", alpha, definition),
        library,
        devices,
        searched=generations != 0,
        search_law=perturbations_of_search(definition, perturbations, robot, library),
        refine=refine,
        files=files_of(task, model, effects),
    )
    _search(options, output or Path("runs") / definition.task)


def _meet_others(distributed: bool, coordinator: str | None, processes: int | None, process: int | None) -> None:
    """Become one of several processes, if the options say so. Raises UserError."""
    if distributed or any(one is not None for one in (coordinator, processes, process)):
        from experiments.distributed import join

        join(coordinator, processes, process)


def files_of(task: str, model: Path | None = None, effects: list[Path] | None = None) -> dict[str, object]:
    """The options by which a replay reads the files that the search has read."""
    return {"--model": model, "--effects": effects, "--task": task if task.endswith(".json") else None}


def _definition(
    task: str,
    start: Path | None,
    drive: str,
    generations: int | None,
    population: int | None,
    trials: int | None,
    refine: int,
) -> "TaskDefinition":
    """The task as the options want it. Raises UserError."""
    from experiments.parameter_file import parameters_at, read_parameters
    from experiments.tasks.definition import load_task
    from sea_jax import DRIVES

    if drive not in DRIVES:
        raise UserError(f"No drive '{drive}'; choose one of {', '.join(DRIVES)}.")
    definition = load_task(task)
    if start is not None:
        found = read_parameters(parameters_at(start), task=definition.task, allow_ungated=True)
        definition = definition.going_on_from(found.values())
    if generations == 0 and not refine:
        raise UserError("--generations 0 searches nothing; give it --refine too, or generations.")
    return definition.with_options(generations, population, trials)


def _search(options: "TuneOptions", folder: Path) -> None:
    """Search in the folder, or go on with what it holds."""
    from experiments.cli.progress import SearchProgress
    from experiments.distributed import is_first, leaving_alone, open_run_together
    from experiments.export import replay_line
    from experiments.smooth.rollout import smooth_rollout
    from experiments.tasks.registry import make_task
    from experiments.tune import tune

    definition, refine = options.definition, options.refine
    # what does not fit together is refused before there is a folder
    make_task(definition, options.model)
    replay_line(options, folder)
    if refine:
        smooth_rollout(options.model, definition, options.library)
    with leaving_alone(), open_run_together(folder, "tune", options.settings()) as run:
        if run.finished and not refine:
            if is_first():
                result = f"{folder}/parameters.json and report.html"
                typer.echo(f"{folder} is finished already; its results are {result}.", err=True)
            return
        with SearchProgress(definition, folder, refine) as progress:
            progress.finish(tune(options, run, progress.update, progress.say, progress.refined))
