"""Figures of a recorded motion: heights, gear velocities with their limits, contact forces, joint torques."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import plotly.graph_objects as go

from experiments.reports.figures import (
    BLUE,
    FORBIDDEN,
    GOLD,
    GREEN,
    GREY,
    LEG_COLOURS,
    ORANGE,
    PURPLE,
    RED,
    line,
    new_figure,
    shade_phases,
)
from experiments.reports.recording import SATURATIONS, Recording, saturations
from mjx_starleth.names import JOINT_SIGN, JOINTS, LEGS
from mjx_starleth.numbers import RobotNumbers

MOTION_COLOURS: Final = (BLUE, ORANGE)  # the motion, the one it is compared with
SATURATION_COLOURS: Final = dict(zip(SATURATIONS, (RED, PURPLE, GOLD, GREEN), strict=True))
_QUIET: Final = {"hoverinfo": "skip", "showlegend": False}


def heights(
    motions: Sequence[Recording],
    desired: np.ndarray,
    phases: Sequence[tuple[str, float, float]],
    foot_radius: float,
) -> go.Figure:
    """Torso and left fore foot of one or two motions over time, and the torso's desired height (T,) (Fig. 5a)."""
    figure = new_figure(height=420)
    figure.add_trace(line(motions[0].time, desired, "torso, desired", GREY, dash="dash", unit="m"))
    for motion, colour in zip(motions, MOTION_COLOURS):
        torso, foot = motion.q[:, 2], motion.foot_position[:, 0, 2] - foot_radius
        figure.add_trace(line(motion.time, torso, f"torso, {motion.drive} drive", colour, width=2.4, unit="m"))
        figure.add_trace(line(motion.time, foot, f"LF foot, {motion.drive} drive", colour, width=1.2, unit="m"))
        top = int(torso.argmax())
        figure.add_annotation(
            x=float(motion.time[top]),
            y=float(torso[top]),
            text=f"<b>{torso[top]:.2f} m</b>",
            font={"color": colour, "size": 13},
            yshift=12,
        )
    shade_phases(figure, phases)
    figure.update_xaxes(title="time [s]", range=[0, float(motions[0].time[-1])])
    figure.update_yaxes(title="height above the ground [m]", rangemode="tozero")
    return figure


def gear_velocities(record: Recording, numbers: RobotNumbers, end: float, leg: int = 0) -> go.Figure:
    """Desired, commanded and reached gear velocity of one leg until `end` [s], limits marked below (Fig. 5b)."""
    figure = new_figure(
        2,
        3,
        height=440,
        shared_xaxes=True,
        row_heights=[0.8, 0.2],
        vertical_spacing=0.05,
        horizontal_spacing=0.05,
        subplot_titles=[f"{LEGS[leg]} {joint}" for joint in JOINTS],
    )
    limit = numbers.loops.gear_speed_limit
    shown = record.time <= end
    time, limited = record.time[shown], saturations(record, numbers)
    signals = {
        "desired": (record.wanted_velocity, GREY, "dot", 1.4),
        "commanded": (record.commanded_velocity, ORANGE, "solid", 1.5),
        "reached": (record.motor_velocity, BLUE, "solid", 2.2),
    }
    for k in range(len(JOINTS)):
        joint, column = 3 * leg + k, k + 1
        place = {"row": 1, "col": column}
        for name, (values, colour, dash, width) in signals.items():
            trace = line(time, values[shown, joint], name, colour, dash=dash, width=width, unit="rad/s")
            figure.add_trace(trace.update(legendgroup=name, showlegend=k == 0), **place)
        for side in (-limit, limit):
            figure.add_hline(side, line={"color": RED, "width": 1, "dash": "dash"}, **place)
        _saturation_lanes(figure, time, {name: limited[name][shown, joint] for name in SATURATIONS}, column)
        figure.update_yaxes(range=_velocity_range(record, shown, leg, limit), **place)
        figure.update_yaxes(showticklabels=k == 0, col=column)
        figure.update_xaxes(title="time [s]", range=[0, end], row=2, col=column)
    figure.update_yaxes(title="gear velocity [rad/s]", row=1, col=1)
    figure.update_xaxes(ticks="", showticklabels=False, row=1)
    return figure


def _saturation_lanes(figure: go.Figure, time: np.ndarray, limited: dict[str, np.ndarray], column: int) -> None:
    """One bar below the other where a limit of the drive holds the joint back."""
    for lane, name in enumerate(SATURATIONS):
        lane_y = np.where(limited[name], len(SATURATIONS) - 1 - lane, np.nan)
        trace = line(time, lane_y, f"at the {name} limit", SATURATION_COLOURS[name], width=7)
        trace.update(hoverinfo="skip", hovertemplate=None, legendgroup=name, showlegend=False)
        figure.add_trace(trace, row=2, col=column)
    figure.update_yaxes(
        range=[-0.6, len(SATURATIONS) - 0.4],
        tickvals=list(range(len(SATURATIONS))),
        ticktext=list(reversed(SATURATIONS)),
        tickfont={"size": 11},
        ticks="",
        row=2,
        col=column,
    )


def _velocity_range(record: Recording, shown: np.ndarray, leg: int, limit: float) -> list[float]:
    """Room for what was commanded and reached; what was only wished for may leave the picture."""
    joints = slice(3 * leg, 3 * leg + 3)
    wanted = np.clip(record.wanted_velocity[shown, joints], -1.5 * limit, 1.5 * limit)
    everything = np.concatenate(
        [wanted, record.commanded_velocity[shown, joints], record.motor_velocity[shown, joints]]
    )
    low, high = float(everything.min()), float(everything.max())
    margin = 0.06 * (high - low) + 0.2
    return [low - margin, high + margin]


def contact_forces(
    record: Recording,
    numbers: RobotNumbers,
    phases: Sequence[tuple[str, float, float]],
    normal: Sequence[float] = (0.0, 0.0, 1.0),
) -> go.Figure:
    """Normal force and use of the friction cone over time, and the forces in the cone's own plane."""
    figure = new_figure(
        2,
        2,
        height=470,
        shared_xaxes=True,
        column_widths=[0.68, 0.32],
        horizontal_spacing=0.09,
        specs=[[{}, {"rowspan": 2}], [{}, None]],
    )
    mu, threshold = numbers.contact.friction, numbers.contact.contact_flag_force
    force_n = record.contact_force @ np.asarray(normal, np.float64)
    force_t = np.linalg.norm(record.contact_force - force_n[..., None] * np.asarray(normal), axis=-1)
    loaded = force_n >= threshold
    with np.errstate(divide="ignore", invalid="ignore"):
        use = np.where(loaded, force_t / (mu * force_n), np.nan)
    for k, (leg, colour) in enumerate(LEG_COLOURS.items()):
        dash = "solid" if k % 2 == 0 else "dash"  # the right legs' curves lie on the left ones' in a straight jump
        style = {"legendgroup": leg, "dash": dash}
        figure.add_trace(line(record.time, force_n[:, k], leg, colour, unit="N", **style), row=1, col=1)
        figure.add_trace(line(record.time, use[:, k], leg, colour, showlegend=False, **style), row=2, col=1)
        here = loaded[:, k]
        figure.add_trace(_cone_dots(force_n[here, k], force_t[here, k], leg, colour), row=1, col=2)
    most = 1.06 * max(float(force_n.max()), threshold)
    _draw_cone(figure, mu, most)
    figure.add_hrect(1, 1.25, fillcolor=FORBIDDEN, line_width=0, layer="below", row=2, col=1)
    figure.add_hline(1, line={"color": RED, "dash": "dash", "width": 1.2}, row=2, col=1)
    shade_phases(figure, phases)
    figure.update_xaxes(title="time [s]", range=[0, float(record.time[-1])], row=2, col=1)
    figure.update_yaxes(title="normal force [N]", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title="|f<sub>t</sub>| / (μ f<sub>n</sub>)", range=[0, 1.2], row=2, col=1)
    return figure


def _cone_dots(force_n: np.ndarray, force_t: np.ndarray, leg: str, colour: str) -> go.Scatter:
    """The samples of one foot in the plane of the friction cone."""
    return go.Scatter(
        x=force_n.astype(np.float32),
        y=force_t.astype(np.float32),
        mode="markers",
        marker={"color": colour, "size": 4, "opacity": 0.55},
        name=leg,
        legendgroup=leg,
        showlegend=False,
        hovertemplate="%{x:.0f} N normal, %{y:.0f} N tangential",
    )


def _draw_cone(figure: go.Figure, mu: float, most: float) -> None:
    """The edge of the friction cone up to a normal force of `most` N, and what lies beyond it."""
    place = {"row": 1, "col": 2}
    edge = {"x": [0, most], "y": [0, mu * most]}
    figure.add_scatter(**edge, mode="lines", line={"color": RED, "dash": "dash", "width": 1.2}, **_QUIET, **place)
    beyond = {"x": [0, most, 0], "y": [0, mu * most, mu * most]}
    figure.add_scatter(**beyond, fill="toself", fillcolor=FORBIDDEN, line_width=0, mode="lines", **_QUIET, **place)
    figure.update_xaxes(title="normal force f<sub>n</sub> [N]", range=[0, most], showticklabels=True, **place)
    figure.update_yaxes(title="tangential force |f<sub>t</sub>| [N]", range=[0, mu * most], **place)


def joint_torques(record: Recording, numbers: RobotNumbers, phases: Sequence[tuple[str, float, float]]) -> go.Figure:
    """Torques of all joints against their limits, every leg with the signs of the left fore leg."""
    figure = new_figure(1, 3, height=350, horizontal_spacing=0.05, subplot_titles=JOINTS)
    torque = record.joint_torque * np.asarray(JOINT_SIGN)
    for k, joint in enumerate(JOINTS):
        place = {"row": 1, "col": k + 1}
        low, high = getattr(numbers.torque_limits_LF, joint)
        for n, (leg, colour) in enumerate(LEG_COLOURS.items()):
            dash = "solid" if n % 2 == 0 else "dash"
            trace = line(record.time, torque[:, 3 * n + k], leg, colour, dash=dash, width=1.5, unit="N m")
            figure.add_trace(trace.update(legendgroup=leg, showlegend=k == 0), **place)
        values = torque[:, k::3]
        bottom, top = min(float(values.min()), low), max(float(values.max()), high)
        room = 0.08 * (top - bottom)
        for edge, beyond in ((high, top + room), (low, bottom - room)):
            figure.add_hrect(*sorted((edge, beyond)), fillcolor=FORBIDDEN, line_width=0, layer="below", **place)
            figure.add_hline(edge, line={"color": RED, "dash": "dash", "width": 1.2}, **place)
        shade_phases(figure, phases, column=k + 1, labels=False)
        figure.update_yaxes(range=[bottom - room, top + room], **place)
        figure.update_xaxes(title="time [s]", range=[0, float(record.time[-1])], **place)
    figure.update_yaxes(title="joint torque [N m]", row=1, col=1)
    return figure
