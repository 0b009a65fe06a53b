"""`starleth tune`: search a motion in simulation and leave a parameter file for the robot."""

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

HELP = """Search a motion in simulation and leave a parameter file for the robot.

The search runs CMA-ES through the task's stages (perfect torque first, the full drive train last), all candidates of a
generation in parallel on all cores. It leaves in the output folder: parameters.json for the robot's controller,
report.html to look at, motion.npz to replay.

Ctrl-C and SIGTERM leave a resumable run: the same command continues it, to the same result to the bit.

--distributed: several processes, on one machine or many, search one population; the result is the same to the bit.

    starleth tune squat_jump
    starleth tune running_trot        or walking_trot, lateral_walk, bound, pronk
    starleth tune squat_jump --generations 100 --seed 3 --output runs/jump3
    starleth tune squat_jump --model learned_model.json
    starleth tune squat_jump --trials 8 --risk cvar     good in the worst quarter of 8 perturbed trials each
    starleth tune squat_jump --refine 40               then downhill by gradients; also on a finished run
    starleth tune squat_jump --generations 0 --refine 40     by gradients alone, from the initial guess

--refine takes slopes from a smooth approximation of the rollout (a jump up to touch-down, a gait's first strides), and
steps that lower the true cost.
"""


def register(app: typer.Typer) -> None:
    app.command("tune", help=HELP)(command)


def command(
    task: Annotated[
        str, typer.Argument(help="A task by name (squat_jump, running_trot, …) or your own task file (.json).")
    ],
    model: ModelOption = None,
    drive: Annotated[
        str, typer.Option(help="Drive of the last stages: full, cheap (no current loop) or ideal.")
    ] = "full",
    generations: Annotated[int | None, typer.Option(min=0, max=1_000_000, help="Generations of all stages.")] = None,
    population: Annotated[int | None, typer.Option(min=4, max=1_000_000, help="Candidates per generation.")] = None,
    trials: Annotated[
        int | None, typer.Option(min=1, max=10_000, help="Perturbed trials per candidate in the last stage.")
    ] = None,
    risk: Annotated[
        str, typer.Option(help="What counts over them: their mean, the worst, or cvar (the tail).")
    ] = "mean",
    alpha: Annotated[
        float | None,
        typer.Option(
            min=0, max=0.999, callback=finite, help="cvar is the mean of the worst share 1 - alpha. Default: 0.75."
        ),
    ] = None,
    refine: Annotated[int, typer.Option(min=0, max=100_000, help="Steps by gradients after the search.")] = 0,
    seed: SeedOption = 0,
    devices: DevicesOption = available_cores(),  # noqa: B008
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder of the run. Default: runs/TASK.")
    ] = None,
    perturbations: Annotated[
        str | None, typer.Option(help="rough, well_kept, or a file, in place of the task's own.")
    ] = None,
    effects: EffectsOption = None,
    distributed: Annotated[
        bool, typer.Option("--distributed", help="One of several processes of one search, as the cluster says.")
    ] = False,
    coordinator: Annotated[str | None, typer.Option(help="The same by hand: host:port of process 0.")] = None,
    processes: Annotated[int | None, typer.Option(min=1, help="How many processes there are.")] = None,
    process: Annotated[int | None, typer.Option(min=0, help="Which of them this is.")] = None,
) -> None:
    terminate_as_interrupt()
    whole_loops()
    start_jax(devices)
    from experiments.distributed import join, leaving_alone, open_run_together

    if distributed or coordinator is not None or processes is not None or process is not None:
        join(coordinator, processes, process)
    from experiments.cli.progress import SearchProgress
    from experiments.effects.library import load_effects
    from experiments.errors import UserError
    from experiments.model import load_model
    from experiments.perturbations import perturbations_of_search, perturbations_of_task
    from experiments.smooth.rollout import smooth_rollout
    from experiments.tasks.definition import load_task
    from experiments.tasks.registry import make_task
    from experiments.tune import TuneOptions, parse_risk, tune
    from sea_jax import DRIVES

    if drive not in DRIVES:
        raise UserError(f"No drive '{drive}'; choose one of {', '.join(DRIVES)}.")
    library = load_effects(effects or ())
    definition = load_task(task)
    if generations == 0 and not refine:
        raise UserError("--generations 0 searches nothing; give it --refine too, or generations.")
    if generations:
        definition = definition.with_generations(generations)
    if population is not None:
        definition = definition.with_population(population)
    if trials is not None:
        definition = definition.with_trials(trials)
    robot = load_model(model, library)
    chosen = perturbations_of_task(definition, perturbations, robot, library)
    search_law = perturbations_of_search(definition, perturbations, robot, library)
    options = TuneOptions(
        definition,
        robot,
        seed,
        chosen,
        None if drive == "full" else drive,
        parse_risk(risk, alpha, definition),
        library,
        devices,
        generations != 0,
        None if search_law == chosen else search_law,
        refine,
    )
    make_task(definition, robot)  # what does not fit together is refused before there is a folder
    if refine:
        smooth_rollout(robot, definition, library)
    folder = output or Path("runs") / definition.task
    with (
        leaving_alone(),
        open_run_together(folder, "tune", options.settings()) as run,
        SearchProgress(definition, folder, refine) as progress,
    ):
        if run.finished and not refine:
            progress.say(f"{folder} is finished already; its results are {folder}/parameters.json and report.html.")
            return
        judged = tune(options, run, progress.update, progress.say, progress.refined)
        progress.finish(judged)
