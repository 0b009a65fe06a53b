"""The report of `starleth compare`: where the model fails, joint by regime, with and without its effects."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from experiments.measurement.compare import Comparison
from experiments.measurement.evidence.drive_replay import CHANNELS as DRIVE_CHANNELS
from experiments.measurement.regimes import REGIMES
from experiments.reports.figures import new_figure
from experiments.reports.page import Block, Card, Cards, Columns, Figure, Section, Table, Text, write_report

TOP = 12  # worst channels that get a row


def write_comparison_report(path: Path, found: Comparison, before: Comparison | None = None) -> None:
    """One HTML file; `before`: the same log against the model without its effects. Raises UserError."""
    worst = found.worst
    cards = [
        Card("Worst channel", f"{worst.over_noise:.2f}", "× noise", worst.name, "good" if found.explained else "bad"),
        Card("Verdict", "explained" if found.explained else "not explained"),
    ]
    if before is not None:
        cards.append(
            Card("Without the model's effects", f"{before.worst.over_noise:.2f}", "× noise", before.worst.name)
        )
    sections = [
        Section("Result", [Cards(cards), Text(f"{found.in_words()} 1.0 is what the noise alone would leave.", "lead")]),
        Section("Where it fails", _side_by_side(found, before)),
        Section("Worst channels", [_channels(found)]),
    ]
    write_report(path, "Model against measurement", found.log.name, sections)


def maps(found: Comparison, label: str) -> list[Block]:
    """Joint by regime, and joint by channel."""
    if found.regimes is None:
        return []
    joints = found.log.atoms.joint_names
    caption = f"Residual over noise by joint and regime, {label}. Empty: no such moment in the log."
    blocks: list[Block] = [Figure(heat(found.regimes, REGIMES, joints), caption)]
    if found.misfit.drive is not None:
        by_channel = heat(found.misfit.drive, DRIVE_CHANNELS, joints)
        blocks.append(Figure(by_channel, f"The same by joint and channel of the drives, {label}."))
    return blocks


def heat(values: np.ndarray, columns: Sequence[str], rows: Sequence[str]) -> go.Figure:
    """A map on a logarithmic colour scale that starts at the noise."""
    figure = new_figure(height=120 + 24 * len(rows))
    shown = np.log10(np.maximum(values, 1.0))
    text = [[f"{v:.1f}" if np.isfinite(v) else "" for v in row] for row in values]
    figure.add_trace(
        go.Heatmap(
            z=np.where(np.isfinite(values), shown, np.nan),
            x=list(columns),
            y=list(rows),
            text=text,
            texttemplate="%{text}",
            colorscale=[[0, "#eef3ee"], [0.15, "#f6d58a"], [1, "#a3262a"]],
            zmin=0,
            zmax=max(1.0, float(np.nanmax(shown))),
            showscale=False,
            hovertemplate="%{y}, %{x}: %{text} × noise<extra></extra>",
        )
    )
    figure.update_yaxes(autorange="reversed")
    return figure


def _side_by_side(found: Comparison, before: Comparison | None) -> list[Block]:
    """The maps, those of the model without its effects on the left."""
    if before is None:
        return maps(found, "with the model as given")
    sides = [maps(before, "without the model's effects"), maps(found, "with them")]
    return [Columns(sides)] if all(sides) else []


def _channels(found: Comparison) -> Table:
    worst = sorted(found.channels, key=lambda c: -c.over_noise)[:TOP]
    rows = [(c.name, *c.cells()) for c in worst]
    caption = "Fit: share of the measured variation that is predicted. Whiteness: 1 for white residuals."
    return Table(("channel", "RMS error (SI)", "over noise", "fit %", "whiteness"), rows, caption, numeric=(1, 2, 3, 4))
