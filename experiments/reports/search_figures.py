"""Figures of a search: convergence, what the cost is made of, what limits the result."""

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from experiments.reports.figures import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    faded,
    line,
    new_figure,
    phase_spans,
    shade_phases,
)
from experiments.reports.recording import History, Sensitivity


def convergence(history: History) -> go.Figure:
    """Cost over generations: best so far, the generations' best, mean and spread, the stages (Fig. 5c)."""
    figure = new_figure(height=390)
    generation = np.arange(1, len(history.best) + 1)
    for n, stage in enumerate(np.unique(history.stage)):
        here, shown = history.stage == stage, {"showlegend": n == 0}
        x, mean, std = generation[here], history.mean[here], history.std[here]
        figure.add_scatter(
            x=np.concatenate([x, x[::-1]]),
            y=np.concatenate([mean + std, (mean - std)[::-1]]).astype(np.float32),
            fill="toself",
            fillcolor=faded(GREY, 0.22),
            line_width=0,
            mode="lines",
            name="mean ± standard deviation",
            legendgroup="spread",
            hoverinfo="skip",
            **shown,
        )
        figure.add_trace(line(x, mean, "generation's mean", GREY, width=1.3, legendgroup="mean", **shown))
        best = line(x, history.best_so_far[here], "best so far in the stage", BLUE, width=2.4, legendgroup="best")
        figure.add_trace(best.update(line_shape="hv", **shown))
    figure.add_scatter(
        x=generation,
        y=history.best.astype(np.float32),
        mode="markers",
        marker={"color": ORANGE, "size": 4},
        name="generation's best",
        hovertemplate="%{y:.4~g}",
    )
    # a fall costs a hundred times more than a good jump: scale the axis to the good ones
    low = float(history.best.min())
    high = float(np.quantile(np.concatenate([history.mean, history.best_so_far]), 0.9))
    room = 0.08 * (high - low) + 1e-6
    shade_phases(figure, _stage_spans(history))
    figure.update_xaxes(title=f"generation (of {history.population} candidates)", range=[0.5, len(generation) + 0.5])
    figure.update_yaxes(title="cost", range=[low - room, high + room])
    return figure


def _stage_spans(history: History) -> list[tuple[str, float, float]]:
    generation = np.arange(0.5, len(history.best))
    return phase_spans(generation, history.stage, history.stage_names)


def bars(values: Mapping[str, float], *, unit: str, height: int | None = None) -> go.Figure:
    """Signed horizontal bars, the largest on top; below zero is good (a cost), above is bad."""
    names = sorted(values, key=lambda name: abs(values[name]))
    numbers = [values[name] for name in names]
    figure = new_figure(height=height or 90 + 26 * len(names))
    figure.add_bar(
        x=numbers,
        y=names,
        orientation="h",
        marker={"color": [GREEN if value < 0 else ORANGE for value in numbers]},
        text=[f"{value:.3g}".replace("-", "\N{MINUS SIGN}") for value in numbers],
        textposition="outside",
        cliponaxis=False,
        hovertemplate=f"%{{x:.4~g}} {unit}<extra></extra>",
    )
    figure.update_layout(hovermode="closest", margin={"t": 16, "r": 60}, bargap=0.35)
    figure.update_xaxes(title=unit)
    figure.update_yaxes(showgrid=False)
    return figure


def tornado(sensitivities: Sequence[Sensitivity], unit: str) -> go.Figure:
    """What a metric gains and loses when one number at a time goes down and up, the strongest on top."""
    rows = sorted(sensitivities, key=lambda s: max(abs(s.change_low), abs(s.change_high)))
    figure = new_figure(height=110 + 26 * len(rows))
    for name, colour, change, label in (
        ("number lowered", PURPLE, "change_low", "low"),
        ("number raised", GREEN, "change_high", "high"),
    ):
        figure.add_bar(
            x=[getattr(row, change) for row in rows],
            y=[row.name for row in rows],
            orientation="h",
            name=name,
            marker={"color": colour},
            customdata=[getattr(row, label) for row in rows],
            hovertemplate=f"%{{customdata}}: %{{x:+.3~g}} {unit}<extra></extra>",
        )
    figure.update_layout(barmode="overlay", hovermode="closest", bargap=0.35)
    figure.update_xaxes(title=f"change [{unit}]", zeroline=True)
    figure.update_yaxes(showgrid=False)
    return figure
