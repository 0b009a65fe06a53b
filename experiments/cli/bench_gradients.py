"""`starleth bench gradients`: CMA-ES, gradients and both at equal wall time."""

import json
from typing import Annotated

import typer

from experiments.cli.options import DevicesOption, ModelOption, available_cores, finite, start_jax, whole_loops

HELP = """What are gradients worth? CMA-ES, gradients, and both one after the other, at equal wall time.

All lower the true cost of a task's last stage, the full model, from its initial guess; compiling is not counted. One
JSON line: the start, what each takes, the cost each ends with for each seed.

    starleth bench gradients                           the jump: three seeds, a minute each (about ten minutes)
    starleth bench gradients running_trot              a gait
    starleth bench gradients --seconds 30 --seeds 1
"""


def gradients(
    task: Annotated[str, typer.Argument(help="A task by name or your own task file.")] = "squat_jump",
    seconds: Annotated[
        float, typer.Option(min=1.0, max=86_400.0, callback=finite, help="Wall time of each method.")
    ] = 60.0,
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Runs of each method.")] = 3,
    model: ModelOption = None,
    devices: DevicesOption = available_cores(),  # noqa: B008
) -> None:
    whole_loops()
    start_jax(devices)
    from experiments.gradient_benchmark import compare
    from experiments.model import load_model
    from experiments.perturbations import perturbations_of_task
    from experiments.tasks.definition import load_task
    from experiments.tune import TuneOptions

    robot, definition = load_model(model), load_task(task)
    options = TuneOptions(definition, robot, 0, perturbations_of_task(definition, None, robot), devices=devices)
    summary, courses = compare(options, seconds, seeds, lambda text: typer.echo(text, err=True))
    print(json.dumps(summary | {"courses": [course._asdict() for course in courses]}))
