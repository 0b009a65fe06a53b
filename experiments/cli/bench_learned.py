"""`starleth bench learned`: a jump of the learned model against one of the nominal, on the robot's stand-in."""

import json
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import DevicesOption, SeedOption, available_cores, start_jax, whole_loops

HELP = """What is a learned effect worth in the next jump?

A second plant that shares no code with the model stands in for the robot, with a hidden effect. Its log in the air is
diagnosed and the model learns what was named; a jump is tuned on the nominal model and one on the learned model, and
both are replayed on that plant. One JSON line: apexes as promised and as reached.

    starleth bench learned                                          friction of all gears (about ten minutes)
    starleth bench learned --effect torque_constant --parameter change=-0.15 --generations 60
"""


def learned(
    effect: Annotated[str, typer.Option(help="Hidden effect, by its name in the second plant.")] = "coulomb_friction",
    where: Annotated[str, typer.Option(help="Where it acts.")] = "all",
    parameter: Annotated[list[str] | None, typer.Option(help="name=value, may be repeated.")] = None,
    generations: Annotated[int, typer.Option(min=4, max=100_000, help="Of each search.")] = 100,
    seed: SeedOption = 0,
    devices: DevicesOption = available_cores(),  # noqa: B008
    folder: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the log, both runs and the result.")
    ] = Path("runs/bench_learned"),
) -> None:
    whole_loops()
    start_jax(devices)
    from experiments.diagnosis_benchmark.beyond_log import beyond_log
    from experiments.errors import UserError
    from experiments.files import write_json
    from experiments.independent_plant.library import Effect

    try:
        given = dict(text.split("=", 1) for text in parameter or ["level=0.006"])
        hidden = Effect(effect, where, {name: float(value) for name, value in given.items()})
        hidden.family.checked(hidden.parameters)
    except (ValueError, KeyError) as error:
        raise UserError(f"The hidden effect is not one of the second plant: {error}.") from None
    result = beyond_log(folder, hidden, generations, seed, devices, lambda text: typer.echo(text, err=True))
    write_json(folder / "learned.json", result)
    print(json.dumps(result))
