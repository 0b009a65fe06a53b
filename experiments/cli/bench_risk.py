"""`starleth bench risk`: plain and robust searches on perturbed trials that neither has seen."""

import json
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import DevicesOption, ModelOption, available_cores, start_jax, whole_loops
from experiments.cli.signals import terminate_as_interrupt
from experiments.cli.tune import files_of

HELP = """Is a robust search worth its price?

Tunes the same task plainly and with several perturbed trials per candidate in the last stage, judged by their CVaR (the
mean of the dearest quarter), then tries both motions on the same trials that neither search has seen. Prints JSON:
success rate, mean cost and CVaR of each, and what the robust one gains, with 95 % intervals. The searches stay in the
output folder as runs of their own; Ctrl-C leaves them resumable, the same command continues.

    starleth bench risk                                   two seeds (half an hour on two cores)
    starleth bench risk --generations 90 --seeds 1        a glance
    starleth bench risk --perturbations well_kept --trials 16
"""


def risk(
    task: Annotated[str, typer.Argument(help="A task by name or your own task file.")] = "squat_jump",
    trials: Annotated[int, typer.Option(min=2, max=10_000, help="Trials per candidate of the robust search.")] = 8,
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Searches of each kind.")] = 2,
    generations: Annotated[int | None, typer.Option(min=1, max=1_000_000, help="Generations of all stages.")] = None,
    unseen: Annotated[int, typer.Option(min=100, max=1_000_000, help="Trials that judge.")] = 512,
    perturbations: Annotated[str, typer.Option(help="rough, well_kept, or a perturbation file.")] = "rough",
    model: ModelOption = None,
    devices: DevicesOption = available_cores(),  # noqa: B008
    folder: Annotated[Path, typer.Option("--output", "-o", help="Folder of the searches and risk.json.")] = Path(
        "runs/bench_risk"
    ),
) -> None:
    terminate_as_interrupt()
    whole_loops()
    start_jax(devices)
    import numpy as np

    from experiments.files import write_json
    from experiments.model import load_model
    from experiments.perturbations import load_perturbations
    from experiments.risk_benchmark import figures, on_unseen_trials, searches
    from experiments.run_folder import make_answer_folder
    from experiments.tasks.definition import load_task
    from experiments.tune import TuneOptions

    robot, definition = load_model(model), load_task(task)
    make_answer_folder(folder)
    if generations:
        definition = definition.with_generations(generations)
    laws, files = load_perturbations(perturbations, robot), files_of(task, model)
    options = TuneOptions(definition, robot, 0, laws, devices=devices, files=files)
    found = searches(options, trials, seeds)
    motions = np.stack([_tuned(each, folder / f"{name}.seed{seed}") for (name, seed), each in found.items()])
    answer = {"task": definition.task, "trials_per_candidate": trials, "perturbations": perturbations}
    answer |= figures(found, on_unseen_trials(options, motions, unseen))
    write_json(folder / "risk.json", answer)
    print(json.dumps(answer))


def _tuned(options, folder: Path):
    """Values that a search found, (n,); a finished one is only read."""
    from experiments.cli.progress import SearchProgress
    from experiments.parameter_file import read_parameters
    from experiments.run_folder import open_run
    from experiments.tune import tune

    with open_run(folder, "tune", options.settings()) as run, SearchProgress(options.definition, folder) as progress:
        if not run.finished:
            progress.finish(tune(options, run, progress.update, progress.say))
        file = read_parameters(run / "parameters.json", allow_ungated=True)
    return options.definition.space().vector(file.values())
