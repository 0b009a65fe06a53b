"""The report of `starleth collect`: how far the seeds agree, which model and task did best, who failed."""

from collections import Counter
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from experiments.reports.figures import BLUE, GOLD, GREEN, ORANGE, PURPLE, RED, new_figure
from experiments.reports.numbers import number, percent
from experiments.reports.page import Block, Card, Cards, Figure, Section, Table, Text, write_report
from experiments.sweep.collect import Row, best_rows, shared_metrics
from experiments.sweep.definition import label

COLOURS = (BLUE, ORANGE, GREEN, PURPLE, GOLD, RED)
UNKNOWN = "\N{EN DASH}"


def write_sweep_report(path: Path, folder: Path, rows: list[Row]) -> None:
    """One HTML file that needs no network. Raises UserError."""
    counts = Counter(row.status for row in rows)
    costs = [row.cost for row in rows if row.cost is not None]
    lost = counts["failed"] + counts["damaged"]
    cards = [Card("Finished", f"{counts['finished']} of {len(rows)}", tone="good" if not lost else "bad")]
    if costs:
        cards.append(Card("Least cost", number(min(costs)), note=f"median {number(float(np.median(costs)))}"))
    if lost:
        cards.append(Card("Failed or damaged", str(lost), tone="bad"))
    result: list[Block] = [Cards(cards)]
    if not costs:
        result.append(Text("No member is finished yet.", "warning"))
    sections = [Section("Result", result)]
    if costs:
        sections.append(Section("Do the seeds agree?", [_costs(rows), *_metrics(rows)]))
        sections.append(Section("The best of each", [_best(rows)]))
    sections.append(Section("All members", [_members(rows)]))
    write_report(path, "Sweep", folder.absolute().name, sections)


def _groups(rows: list[Row]) -> dict[str, list[Row]]:
    """Finished rows by task and model."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        if row.file is not None:
            found.setdefault(f"{label(row.member.task)} · {label(row.member.model)}", []).append(row)
    return found


def _strip(rows: list[Row], value, title: str) -> go.Figure:
    """A dot for every seed, a line at the median of each group."""
    groups = _groups(rows)
    figure = new_figure(height=340)
    for n, (name, members) in enumerate(groups.items()):
        values = np.array([value(row) for row in members], float)
        spread = n + np.linspace(-0.18, 0.18, len(members)) if len(members) > 1 else np.array([float(n)])
        colour = COLOURS[n % len(COLOURS)]
        median = float(np.median(values))
        figure.add_scatter(
            x=spread,
            y=values,
            mode="markers",
            marker={"color": colour, "size": 9},
            name=name,
            customdata=[row.member.seed for row in members],
            hovertemplate="seed %{customdata}: %{y:.4~g}<extra></extra>",
            showlegend=False,
        )
        figure.add_scatter(
            x=[n - 0.3, n + 0.3],
            y=[median, median],
            mode="lines",
            line_color=colour,
            showlegend=False,
            hoverinfo="skip",
        )
    figure.update_xaxes(tickvals=list(range(len(groups))), ticktext=list(groups), range=[-0.6, len(groups) - 0.4])
    figure.update_yaxes(title=title)
    return figure


def _costs(rows: list[Row]) -> Block:
    caption = "Cost of each seed's result without perturbations, and the median; less is better."
    return Figure(_strip(rows, lambda row: row.cost, "cost"), caption)


def _metrics(rows: list[Row]) -> list[Block]:
    blocks: list[Block] = []
    for name in shared_metrics(rows, 1):
        unit = next(row.file.metrics[name].unit for row in rows if row.file is not None)
        words = name.replace("_", " ")
        title = words if unit == "-" else f"{words} [{unit}]"
        blocks.append(Figure(_strip(rows, lambda row, n=name: row.figure(n), title), f"The same for {words}."))
    return blocks


def _best(rows: list[Row]) -> Block:
    header = ["task", "model", "seed", "cost", "perturbed trials that succeed", "parameters"]
    table = [
        [
            label(row.member.task),
            label(row.member.model),
            row.member.seed,
            number(row.cost),
            UNKNOWN if row.success_rate is None else percent(row.success_rate),
            f"members/{row.member.name}/parameters.json",
        ]
        for row in best_rows(rows)
    ]
    return Table(header, table, "The seed of least cost for each task and model.", numeric=(2, 3, 4))


def _members(rows: list[Row]) -> Block:
    metrics = shared_metrics(rows)

    def shown(value: float | None) -> str:
        return UNKNOWN if value is None else number(value)

    def cells(row: Row) -> list[str]:
        figures = [row.cost, row.success_rate, *(row.figure(name) for name in metrics), row.seconds]
        return [row.member.name, row.status, *map(shown, figures), row.sentence]

    header = ["member", "status", "cost", "success", *(m.replace("_", " ") for m in metrics), "seconds", ""]
    return Table(
        header, [cells(row) for row in rows], "Every member as it stands.", numeric=tuple(range(2, 5 + len(metrics)))
    )
