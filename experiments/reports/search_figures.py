"""Figures of a search: convergence, what the cost is made of, what limits the result."""

from collections.abc import Mapping, Sequence
from typing import Final

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

SIGMA_TICKS: Final = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1)


def convergence(history: History) -> go.Figure:
    """Cost over generations: best so far, each generation's best, mean and spread, the stages (Fig. 5c).

    Below it the step size of the search, where it is known.
    """
    with_sigma = history.sigma is not None
    rows = {"row_heights": [0.76, 0.24], "shared_xaxes": True, "vertical_spacing": 0.06} if with_sigma else {}
    figure = new_figure(1 + with_sigma, height=470 if with_sigma else 390, **rows)
    generation = np.arange(1, len(history.best) + 1)
    if history.std is not None:
        _add_spread(figure, history, generation)
    for n, stage in enumerate(np.unique(history.stage)):
        here, shown = history.stage == stage, {"showlegend": n == 0}
        x = generation[here]
        mean = line(x, history.mean[here], "generation's mean", GREY, width=1.3, legendgroup="mean", **shown)
        best = line(x, history.best_so_far[here], "best so far in the stage", BLUE, width=2.4, legendgroup="best")
        figure.add_trace(mean, row=1, col=1)
        figure.add_trace(best.update(line_shape="hv", **shown), row=1, col=1)
    dots = line(generation, history.best, "generation's best", ORANGE).update(mode="markers", marker_size=4, line=None)
    figure.add_trace(dots.update(marker_color=ORANGE), row=1, col=1)
    if with_sigma:
        figure.add_trace(line(generation, history.sigma, "step size", PURPLE, showlegend=False), row=2, col=1)
        figure.update_yaxes(title="step size σ", type="log", tickvals=SIGMA_TICKS, row=2, col=1)
    shade_phases(figure, phase_spans(generation - 0.5, history.stage, history.stage_names))
    candidates = f"generation (of {history.population} candidates)"
    figure.update_xaxes(range=[0.5, len(generation) + 0.5])
    figure.update_xaxes(title=candidates, row=1 + with_sigma, col=1)
    figure.update_yaxes(title="cost", range=_cost_range(history), row=1, col=1)
    return figure


def descent(costs: np.ndarray) -> go.Figure:
    """True cost over the steps of a refinement."""
    figure = new_figure(height=300)
    figure.add_trace(
        line(np.arange(len(costs)), costs, "cost", BLUE, width=2.4, showlegend=False).update(line_shape="hv")
    )
    figure.update_xaxes(title="step of the refinement")
    figure.update_yaxes(title="cost")
    return figure


def _add_spread(figure: go.Figure, history: History, generation: np.ndarray) -> None:
    """The band of mean plus and minus one standard deviation, stage by stage."""
    for n, stage in enumerate(np.unique(history.stage)):
        here = (history.stage == stage) & np.isfinite(history.mean + history.std)
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
            showlegend=n == 0,
            hoverinfo="skip",
            row=1,
            col=1,
        )


def _cost_range(history: History) -> list[float]:
    """Scaled to the best of the generations: a fall costs a hundred times more than a good jump."""
    if not np.isfinite(history.best).any():
        return [-1.0, 1.0]
    low, high = float(np.nanmin(history.best)), float(np.nanquantile(history.best, 0.97))
    width = max(high - low, 1e-6)
    return [low - 0.08 * width, high + 0.4 * width]


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
