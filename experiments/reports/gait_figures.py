"""Figures of a recorded gait: which feet stand when, speed, height and pitch."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import plotly.graph_objects as go

from experiments.reports.figures import BLUE, GREEN, GREY, LEG_COLOURS, ORANGE, faded, line, new_figure, shade_phases
from experiments.reports.recording import GaitRecord

BAR, PLAN = 0.28, 0.16  # half thickness of the bars of reached contact and of the plan above it
LANES: Final = tuple(reversed(LEG_COLOURS))  # LF on top, as in the paper
SPEEDS: Final = (("forward", "m/s"), ("to the left", "m/s"), ("turning", "rad/s"))

Spans = Sequence[tuple[str, float, float]]


def stretches(time: np.ndarray, on: np.ndarray) -> list[tuple[float, float]]:
    """(start, end) of each stretch in which `on` (T,) holds."""
    step = float(time[1] - time[0])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(on, int), [0]])))
    return [(float(time[a]), float(time[b - 1]) + step) for a, b in edges.reshape(-1, 2)]


def hildebrand(record: GaitRecord, contact_force: float, strides: Spans) -> go.Figure:
    """Planned stance and reached contact of every foot (Fig. 4), and where all feet are in the air."""
    figure = new_figure(height=320)
    loaded = np.linalg.norm(record.contact_force, axis=-1) >= contact_force
    for lane, leg in enumerate(LANES):
        k, colour = list(LEG_COLOURS).index(leg), LEG_COLOURS[leg]
        reached = stretches(record.time, loaded[:, k])
        planned = stretches(record.time, record.planned_stance[:, k] > 0.5)
        first = lane == len(LANES) - 1
        figure.add_trace(_bars(planned, lane + 0.3, PLAN, faded(GREY, 0.55), "planned", first))
        figure.add_trace(_bars(reached, lane - 0.12, BAR, colour, f"{leg} on the ground", True))
    for start, end in stretches(record.time, ~loaded.any(1)):
        figure.add_vrect(x0=start, x1=end, fillcolor=faded(GREEN, 0.14), line_width=0, layer="below")
    shade_phases(figure, strides)
    figure.update_xaxes(title="time [s]", range=[strides[0][1], strides[-1][2]])
    figure.update_yaxes(
        tickvals=list(range(len(LANES))), ticktext=LANES, range=[-0.6, len(LANES) - 0.4], showgrid=False
    )
    figure.update_layout(hovermode="closest")
    return figure


def _bars(spans: list[tuple[float, float]], lane: float, half: float, colour: str, name: str, shown: bool):
    """Filled bars of one lane as one trace."""
    x: list[float | None] = []
    y: list[float | None] = []
    for start, end in spans:
        x += [start, end, end, start, start, None]
        y += [lane - half, lane - half, lane + half, lane + half, lane - half, None]
    return go.Scatter(
        x=x, y=y, fill="toself", fillcolor=colour, line_width=0, mode="lines", name=name, legendgroup=name,
        showlegend=shown, hoverinfo="name",
    )  # fmt: skip


def speeds(record: GaitRecord, stride: float) -> go.Figure:
    """Speed commanded, reached, reached over one stride, and as the robot estimates it."""
    figure = new_figure(3, height=560, shared_xaxes=True, vertical_spacing=0.05)
    for k, (name, unit) in enumerate(SPEEDS):
        first = k == 0
        for values, label, colour, style in (
            (record.velocity, "reached", faded(BLUE, 0.45), {"width": 1.2}),
            (record.estimated_velocity, "estimated by the robot", faded(ORANGE, 0.7), {"width": 1.0, "dash": "dot"}),
            (over_strides(record.velocity, record.time, stride), "reached, mean of a stride", BLUE, {"width": 2.4}),
            (record.command, "commanded", GREY, {"dash": "dash"}),
        ):
            trace = line(record.time, values[:, k], label, colour, unit=unit, **style)
            figure.add_trace(trace.update(legendgroup=label, showlegend=first), row=k + 1, col=1)
        figure.update_yaxes(title=f"{name} [{unit}]", row=k + 1, col=1)
    figure.update_xaxes(range=[0, float(record.time[-1])])
    figure.update_xaxes(title="time [s]", row=3, col=1)
    return figure


def over_strides(values: np.ndarray, time: np.ndarray, stride: float) -> np.ndarray:
    """Running mean (T, k) over one stride (s), NaN where there is not a whole one."""
    width = max(1, round(stride / float(time[1] - time[0])))
    sums = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), values]), 0)
    means = np.full(values.shape, np.nan)
    start = width // 2
    whole = (sums[width:] - sums[:-width]) / width
    means[start : start + len(whole)] = whole
    return means


def height_and_pitch(record: GaitRecord, foot_radius: float, strides: Spans) -> go.Figure:
    """Height of the torso and of the fore feet, and pitch, with what the controller wants."""
    figure = new_figure(2, height=480, shared_xaxes=True, row_heights=[0.62, 0.38], vertical_spacing=0.06)
    time, degrees = record.time, 180.0 / np.pi
    figure.add_trace(line(time, record.desired_height, "desired", GREY, dash="dash", unit="m"), row=1, col=1)
    figure.add_trace(line(time, record.q[:, 2], "torso", BLUE, width=2.4, unit="m"), row=1, col=1)
    for k, leg in ((0, "LF"), (2, "LH")):
        foot = record.foot_position[:, k, 2] - foot_radius
        figure.add_trace(line(time, foot, f"{leg} foot", LEG_COLOURS[leg], width=1.2, unit="m"), row=1, col=1)
    desired = line(time, degrees * record.desired_pitch, "desired", GREY, dash="dash", unit="°", showlegend=False)
    figure.add_trace(desired, row=2, col=1)
    pitch = line(time, degrees * record.pitch, "pitch", BLUE, width=2.4, unit="°", showlegend=False)
    figure.add_trace(pitch, row=2, col=1)
    shade_phases(figure, strides, labels=False)
    figure.update_xaxes(range=[strides[0][1], strides[-1][2]])
    figure.update_xaxes(title="time [s]", row=2, col=1)
    figure.update_yaxes(title="height [m]", row=1, col=1)
    figure.update_yaxes(title="pitch, nose down [°]", row=2, col=1)
    return figure
