"""`starleth bench diagnosis`: how often the diagnosis is right."""

import json
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import SeedOption, available_cores, finite, start_jax, whole_loops

HELP = """How often is the diagnosis right?

Makes logs with hidden effects on a second plant that shares no code with the model, diagnoses each, and compares with
the sealed truth; beside it what one would do instead. Resumes: what the folder holds is not done again.

    starleth bench diagnosis --size 20         a glance (half an hour on two cores)
    starleth bench diagnosis --size 300        the whole (hours)
    starleth bench diagnosis --methods diagnosis    without what one would do instead, three times as fast
"""


def diagnosis(
    size: Annotated[int, typer.Option(min=8, help="Number of logs.")] = 20,
    seed: SeedOption = 0,
    duration: Annotated[float, typer.Option(min=4.0, max=60.0, callback=finite, help="Length of each log, s.")] = 8.0,
    methods: Annotated[
        str, typer.Option(help="Which of diagnosis, parameters, best_single, sparse, removed; with commas between.")
    ] = "diagnosis,parameters,best_single,sparse,removed",
    folder: Annotated[Path, typer.Option("--output", "-o", help="Folder for logs, answers and table.")] = Path(
        "runs/bench_diagnosis"
    ),
) -> None:
    whole_loops()
    start_jax()
    from rich.console import Console
    from rich.table import Table

    from experiments.diagnosis_benchmark.run import run

    workers = available_cores()
    names = [name.strip() for name in methods.split(",") if name.strip()]
    result = run(folder, size, seed, duration, names, workers, lambda text: typer.echo(text, err=True))
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
