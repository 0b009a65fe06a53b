"""`starleth bench`: speed side by side with MuJoCo C; `starleth bench diagnosis`: how often the diagnosis is right."""

import json
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli import bench_gradients
from experiments.cli.options import DevicesOption, ModelOption, SeedOption, available_cores, start_jax

HELP = """Measure speed side by side with MuJoCo C in one run, on all cores; one JSON line per entry.

    starleth bench                    all entries (about two minutes, mostly compiling)
    starleth bench --rounds 20        more rounds; the best of each entry counts
    starleth bench diagnosis          how often the diagnosis is right, on hidden effects of an independent plant
"""
DIAGNOSIS = """How often is the diagnosis right?

Makes logs with hidden effects on a second plant that shares no code with the model, diagnoses each, and compares with
the sealed truth; beside it what one would do instead. Resumes: what the folder holds is not done again.

    starleth bench diagnosis --size 20         a glance (half an hour on two cores)
    starleth bench diagnosis --size 300        the whole (hours)
"""


def register(app: typer.Typer) -> None:
    bench = typer.Typer(help=HELP, invoke_without_command=True)
    bench.callback()(speed)
    bench.command("diagnosis", help=DIAGNOSIS)(diagnosis)
    bench.command("gradients", help=bench_gradients.HELP)(bench_gradients.gradients)
    app.add_typer(bench, name="bench")


def speed(
    context: typer.Context,
    model: ModelOption = None,
    devices: DevicesOption = available_cores(),  # noqa: B008
    batch: Annotated[
        int | None, typer.Option(min=1, help="Environments per entry; default: the fastest found.")
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help="Rounds in which the entries take turns.")] = 5,
) -> None:
    if context.invoked_subcommand is not None:
        return
    start_jax(devices)
    from experiments import bench
    from experiments.model import load_model

    for line in bench.measure(bench.entries(load_model(model), devices, batch), rounds):
        print(json.dumps(line), flush=True)


def diagnosis(
    size: Annotated[int, typer.Option(min=8, help="Number of logs.")] = 20,
    seed: SeedOption = 0,
    duration: Annotated[float, typer.Option(min=4.0, max=60.0, help="Length of each log, s.")] = 8.0,
    folder: Annotated[Path, typer.Option("--output", "-o", help="Folder for logs, answers and table.")] = Path(
        "runs/bench_diagnosis"
    ),
) -> None:
    start_jax()
    from rich.console import Console
    from rich.table import Table

    from experiments.diagnosis_benchmark.run import run

    workers = available_cores()
    result = run(folder, size, seed, duration, workers, lambda text: typer.echo(text, err=True))
    figures = Table(title=f"{result['cases']} logs, hits of cases")
    columns = list(result["methods"][0])
    for column in columns:
        figures.add_column(column.replace("_", " "))
    for row in result["methods"]:
        figures.add_row(*(value if isinstance(value, str) else f"{value[0]}/{value[1]}" for value in row.values()))
    Console(stderr=True).print(figures)
    for line in result["wrong"]:
        typer.echo(line, err=True)
    print(json.dumps(result))
