"""`starleth collect`: the results of a sweep side by side."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Column, Table

HELP = """The results of a sweep side by side: a table, sweep.json, and report.html with pictures.

May be asked at any time, also while the sweep is running.

    starleth collect runs/seeds
"""
COLOURS = {"finished": "green", "failed": "red", "damaged": "red", "unfinished": "yellow", "not begun": "dim"}
WIDE = 200  # characters where there is no terminal


def register(app: typer.Typer) -> None:
    app.command("collect", help=HELP)(command)


def command(folder: Annotated[Path, typer.Argument(help="The folder of a sweep.")]) -> None:
    from experiments.files import write_json
    from experiments.reports.sweep import write_sweep_report
    from experiments.sweep.collect import collect, summary
    from experiments.sweep.run import sweep_in

    rows = collect(folder, sweep_in(folder))
    write_json(folder / "sweep.json", summary(rows))
    write_sweep_report(folder / "report.html", folder, rows)
    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDE)
    console.print(_table(rows))
    for row in rows:
        if row.sentence:
            console.print(f"{row.member.name}: {row.sentence}", markup=False, highlight=False, soft_wrap=True)
    console.print(f"{folder}/sweep.json   to look at: {folder}/report.html", markup=False, highlight=False)


def _table(rows) -> Table:
    from experiments.sweep.collect import best_rows, shared_metrics

    metrics = shared_metrics(rows)
    best = {row.member.name for row in best_rows(rows)}
    table = Table(Column("member", no_wrap=True), "status", "cost", "success", *metrics)
    for row in rows:
        figures = [row.cost, row.success_rate, *(row.figure(name) for name in metrics)]
        shown = ["" if value is None else f"{value:.4g}" for value in figures]
        colour = COLOURS[row.status]
        name = f"[bold]{row.member.name}[/bold]" if row.member.name in best else row.member.name
        table.add_row(name, f"[{colour}]{row.status}[/{colour}]", *shown)
    return table
