"""The look that all figures share: colours, layout, phases of a motion in the background."""

import itertools
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from mjx_starleth.names import LEGS

# Readable on white and on near-black, apart for colour-blind eyes (after Okabe and Ito)
BLUE: Final = "#3a7fd0"
ORANGE: Final = "#e0802f"
GREEN: Final = "#2a9d78"
PURPLE: Final = "#9a6cc9"
RED: Final = "#d4483d"
GOLD: Final = "#c9a11f"
GREY: Final = "#8a919c"
LEG_COLOURS: Final = dict(zip(LEGS, (BLUE, ORANGE, GREEN, PURPLE), strict=True))

BAND: Final = "rgba(128,136,148,0.09)"  # behind every other phase
FORBIDDEN: Final = "rgba(212,72,61,0.10)"  # beyond a limit


def faded(colour: str, alpha: float) -> str:
    """A '#rrggbb' colour with transparency."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{alpha})"


def new_figure(rows: int = 1, columns: int = 1, *, height: int = 360, **options: Any) -> go.Figure:
    """Subplots in the reports' layout: legend above, titles of subplots flush left. `options`: make_subplots."""
    options = {"horizontal_spacing": 0.07, "vertical_spacing": 0.09} | options
    figure = make_subplots(rows=rows, cols=columns, **options)
    titles = bool(options.get("subplot_titles"))
    figure.update_layout(
        height=height,
        margin={"l": 58, "r": 14, "t": 64 if titles else 44, "b": 46},
        legend={"orientation": "h", "x": 0, "y": 1, "yref": "container", "yanchor": "top", "xanchor": "left"},
    )
    for annotation in figure.layout.annotations:  # so far these are the subplots' titles
        annotation.update(font={"size": 13}, yshift=2)
    return figure


def line(x: np.ndarray, y: np.ndarray, name: str, colour: str, **options: Any) -> go.Scatter:
    """A curve; the data is kept in float32. `options`: of Scatter, plus `dash`, `width` and `unit` for the hover."""
    style = {"color": colour, "dash": options.pop("dash", "solid"), "width": options.pop("width", 1.8)}
    unit = options.pop("unit", "")
    options.setdefault("hovertemplate", f"%{{y:.4~g}} {unit}")
    return go.Scatter(
        x=np.asarray(x, np.float32),
        y=np.asarray(y, np.float32),
        name=name,
        mode="lines",
        line=style,
        **options,
    )


def phase_spans(time: np.ndarray, phase: np.ndarray, names: Sequence[str]) -> list[tuple[str, float, float]]:
    """(name, start, end) of each stretch of constant phase."""
    step = float(time[1] - time[0]) if len(time) > 1 else 0.0
    starts = [0, *(np.flatnonzero(np.diff(phase)) + 1).tolist(), len(phase)]
    return [(names[int(phase[a])], float(time[a]), float(time[b - 1]) + step) for a, b in itertools.pairwise(starts)]


def shade_phases(
    figure: go.Figure, spans: Sequence[tuple[str, float, float]], *, column: int = 1, labels: bool = True
) -> None:
    """Every other phase as a grey band behind a column of subplots, the names along its top."""
    for n, (name, start, end) in enumerate(spans):
        if n % 2:
            figure.add_vrect(x0=start, x1=end, fillcolor=BAND, line_width=0, layer="below", row="all", col=column)
        if not labels:
            continue
        figure.add_annotation(
            x=(start + end) / 2,
            y=1,
            yref="y domain",
            yanchor="bottom",
            text=name,
            row=1,
            col=column,
            font={"size": 11},
        )
