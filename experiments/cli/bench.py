"""`starleth bench`: speed side by side with MuJoCo C, one JSON line per entry."""

import json
from typing import Annotated

import typer

from experiments.cli.options import DevicesOption, ModelOption, available_cores, start_jax

HELP = """Measure speed side by side with MuJoCo C in one run, on all cores; one JSON line per entry.

    starleth bench                    all entries (about two minutes, mostly compiling)
    starleth bench --rounds 20        more rounds; the best of each entry counts
"""


def register(app: typer.Typer) -> None:
    app.command("bench", help=HELP)(command)


def command(
    model: ModelOption = None,
    devices: DevicesOption = available_cores(),  # noqa: B008
    batch: Annotated[
        int | None, typer.Option(min=1, help="Environments per entry; default: the fastest found.")
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help="Rounds in which the entries take turns.")] = 5,
) -> None:
    start_jax(devices)
    from experiments import bench
    from experiments.model import load_model

    for line in bench.measure(bench.entries(load_model(model), devices, batch), rounds):
        print(json.dumps(line), flush=True)
