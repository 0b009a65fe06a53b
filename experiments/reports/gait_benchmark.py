"""The report of `starleth bench gaits`: how long the gaits keep going, what throws them over, how they look."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from experiments.gait_benchmark.disturbances import SWEEPS, Sweep
from experiments.gait_benchmark.run import GaitResult
from experiments.reports import gait_figures
from experiments.reports.figures import BLUE, GOLD, GREEN, GREY, ORANGE, PURPLE, faded, new_figure
from experiments.reports.gait import last_strides
from experiments.reports.numbers import number, percent
from experiments.reports.page import Block, Card, Cards, Code, Figure, Section, Table, Text, write_report
from experiments.reports.playback import Playback, Track
from mjx_starleth.numbers import RobotNumbers

COLOURS = (BLUE, ORANGE, GREEN, PURPLE, GOLD)
ASKED = 0.99  # share of the unseen trials that a gait should survive
SNAPSHOTS = 6


def write_gait_benchmark_report(
    path: Path | str, results: Sequence[GaitResult], numbers: RobotNumbers, command: str
) -> None:
    """One HTML file that needs no network, written atomically. Raises UserError."""
    rows = [result.figures for result in results]
    sections = [Section("Result", [_cards(rows), _table(rows)])]
    if any(row["sweeps"] for row in rows):
        sections.append(Section("Survival over the disturbance", _curves(rows)))
    for result in results:
        if result.record is not None:
            sections.append(Section(_title(result.figures["gait"]), _motion(result, numbers)))
    repeat = [Code(command), Text("The figures stand in gaits.json beside this page.")]
    write_report(
        path, "Gaits", ", ".join(_title(row["gait"]) for row in rows), [*sections, Section("How to repeat it", repeat)]
    )


def _title(gait: str) -> str:
    return gait.replace("_", " ").capitalize()


def _cards(rows: Sequence[dict[str, Any]]) -> Cards:
    def card(row: dict[str, Any]) -> Card:
        good = row["survived"] >= ASKED * row["trials"]
        note = f"unseen trials survive {row['cycles']} strides; {row['initial_guess_survived']} with the initial guess"
        return Card(
            _title(row["gait"]), f"{row['survived']} of {row['trials']}", note=note, tone="good" if good else "bad"
        )

    return Cards([card(row) for row in rows])


def _table(rows: Sequence[dict[str, Any]]) -> Table:
    header = [
        "gait",
        "stride [s]",
        "speed commanded [m/s]",
        "reached",
        "in the air",
        "a flight lasts [s]",
        "flights a stride",
        "in MuJoCo C",
    ]
    cells = []
    for row in rows:
        other = row.get("mujoco_c")
        there = "not run"
        if other is not None:
            there = f"{percent(other['speed_ratio'])} of the speed" if other["survived"] else "falls"
        figures = (row[key] for key in ("speed_reached", "flight_fraction", "flight_duration", "flights_per_stride"))
        reached, aloft, flight, often = (float("nan") if x is None else x for x in figures)
        in_air = percent(aloft) if aloft == aloft else number(aloft)
        commanded = number(row["speed_commanded"], 2)
        cells.append(
            [
                _title(row["gait"]),
                number(row["stride"]),
                commanded,
                number(reached, 2),
                in_air,
                number(flight, 2),
                number(often, 1),
                there,
            ]
        )
    caption = (
        "Means over the unseen trials that do not fall: full drive train, estimated state, pushes, unknown ground, "
        "noise and a robot that is a little off. MuJoCo C: the same controls and drives, its own contact, nothing off."
    )
    return Table(header, cells, caption, numeric=(1, 2, 3, 4, 5, 6))


def _curves(rows: Sequence[dict[str, Any]]) -> list[Block]:
    blocks: list[Block] = []
    for sweep in SWEEPS:
        found = [(row["gait"], s) for row in rows for s in row["sweeps"] if s["disturbance"] == sweep.name]
        if not found:
            continue
        trials = found[0][1]["points"][0]["trials"]
        caption = (
            f"{sweep.title}: share of {trials} trials without a fall, with 95 % intervals; dotted, what is asked for."
        )
        blocks.append(Figure(_curve(sweep, found), caption))
    return blocks


def _curve(sweep: Sweep, found: Sequence[tuple[str, dict[str, Any]]]) -> go.Figure:
    figure = new_figure(height=300)
    for (gait, curve), colour in zip(found, COLOURS):
        points = curve["points"]
        share = [100 * p["survived"] / p["trials"] for p in points]
        low, high = ([100 * p["interval"][k] for p in points] for k in (0, 1))
        figure.add_scatter(
            x=[p["level"] for p in points],
            y=share,
            mode="lines+markers",
            name=_title(gait),
            line={"color": colour, "width": 2},
            error_y={
                "array": [h - s for h, s in zip(high, share)],
                "arrayminus": [s - b for s, b in zip(share, low)],
                "color": faded(colour, 0.35),
                "thickness": 1,
            },
            hovertemplate=f"%{{x:g}} {sweep.unit}: %{{y:.0f}} %",
        )
    figure.add_vline(x=sweep.asked, line={"color": GREY, "dash": "dot"})
    figure.update_xaxes(title=sweep.title if sweep.unit == "1" else f"{sweep.title} [{sweep.unit}]")
    figure.update_yaxes(title="no fall [%]", range=[-4, 104])
    return figure


def _motion(result: GaitResult, numbers: RobotNumbers) -> list[Block]:
    record = result.record
    assert record is not None
    strides = last_strides(record)
    force = numbers.contact.contact_flag_force
    shown = last_strides(record, 1)
    step = (shown[0][2] - shown[0][1]) / SNAPSHOTS
    snapshots = [shown[0][1] + k * step for k in range(SNAPSHOTS)]
    return [
        Figure(
            gait_figures.hildebrand(record, force, strides),
            f"Contact pattern of the last strides in MuJoCo C. Grey, planned stance; coloured, feet that press on the "
            f"ground with at least {force:g} N; behind, green where no foot does: flight.",
            time_axis=True,
        ),
        Playback(
            [Track(record.drive, record.q, record.contact_force)],
            float(record.time[1] - record.time[0]),
            numbers,
            "The gait in MuJoCo C, to be played and turned; below, its last stride from the robot’s right side.",
            snapshots=snapshots,
            poster=snapshots[0],
        ),
    ]
