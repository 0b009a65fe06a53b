"""The figures of the squat jump's report (the paper's Fig. 5 and what else one asks of a jump)."""

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
    faded,
    line,
    new_figure,
    phase_spans,
    shade_phases,
)
from experiments.reports.recording import (
    JUMP_PHASES,
    SATURATIONS,
    History,
    JumpRecord,
    Recording,
    Sensitivity,
    saturations,
)
from mjx_starleth.names import JOINT_SIGN, JOINTS, LEGS
from mjx_starleth.numbers import RobotNumbers

DRIVE_COLOURS: Final = (BLUE, ORANGE)  # the drive of the run, the one it is compared with
SATURATION_COLOURS: Final = dict(zip(SATURATIONS, (RED, PURPLE, GOLD, GREEN), strict=True))
AFTER_TAKE_OFF: Final = 0.03  # s shown of the flight when the launch is the subject


def spans(record: JumpRecord) -> list[tuple[str, float, float]]:
    """Phases of the jump: (name, start, end)."""
    return phase_spans(record.time, record.phase, JUMP_PHASES)


def heights(record: JumpRecord, other: JumpRecord | None, foot_radius: float) -> go.Figure:
    """Torso and left fore foot over time, desired and reached (Fig. 5a)."""
    figure = new_figure(height=420)
    figure.add_trace(line(record.time, record.desired_height, "torso, desired", GREY, dash="dash", unit="m"))
    for motion, colour in zip((record, other), DRIVE_COLOURS):
        if motion is None:
            continue
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
    shade_phases(figure, spans(record))
    figure.update_xaxes(title="time [s]", range=[0, float(record.time[-1])])
    figure.update_yaxes(title="height above the ground [m]", rangemode="tozero")
    return figure


def gear_velocities(record: JumpRecord, numbers: RobotNumbers, leg: int = 0) -> go.Figure:
    """Desired, commanded and reached gear velocity of one leg until take-off, limits marked below (Fig. 5b)."""
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
    limit, end = numbers.loops.gear_speed_limit, float(record.time[record.take_off]) + AFTER_TAKE_OFF
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
        for lane, name in enumerate(SATURATIONS):
            lane_y = np.where(limited[name][shown, joint], len(SATURATIONS) - 1 - lane, np.nan)
            trace = line(time, lane_y, f"at the {name} limit", SATURATION_COLOURS[name], width=7)
            trace.update(hoverinfo="skip", hovertemplate=None, legendgroup=name, showlegend=False)
            figure.add_trace(trace, row=2, col=column)
        figure.update_yaxes(range=_velocity_range(record, shown, leg, limit), **place)
        figure.update_yaxes(
            range=[-0.6, len(SATURATIONS) - 0.4],
            tickvals=list(range(len(SATURATIONS))),
            ticktext=list(reversed(SATURATIONS)),
            showticklabels=k == 0,
            tickfont={"size": 11},
            ticks="",
            row=2,
            col=column,
        )
        figure.update_yaxes(showticklabels=k == 0, **place)
        figure.update_xaxes(title="time [s]", range=[0, end], row=2, col=column)
    figure.update_yaxes(title="gear velocity [rad/s]", row=1, col=1)
    figure.update_xaxes(ticks="", showticklabels=False, row=1)
    return figure


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
        figure.add_scatter(
            x=force_n[loaded[:, k], k].astype(np.float32),
            y=force_t[loaded[:, k], k].astype(np.float32),
            mode="markers",
            marker={"color": colour, "size": 4, "opacity": 0.55},
            name=leg,
            legendgroup=leg,
            showlegend=False,
            hovertemplate="%{x:.0f} N normal, %{y:.0f} N tangential",
            row=1,
            col=2,
        )
    most = 1.06 * max(float(force_n.max()), threshold)
    cone = {"x": [0, most], "y": [0, mu * most]}
    figure.add_scatter(**cone, mode="lines", line={"color": RED, "dash": "dash", "width": 1.2}, **_quiet, row=1, col=2)
    figure.add_scatter(
        x=[0, most, 0],
        y=[0, mu * most, mu * most],
        fill="toself",
        fillcolor=FORBIDDEN,
        line_width=0,
        mode="lines",
        **_quiet,
        row=1,
        col=2,
    )
    figure.add_hrect(1, 1.25, fillcolor=FORBIDDEN, line_width=0, layer="below", row=2, col=1)
    figure.add_hline(1, line={"color": RED, "dash": "dash", "width": 1.2}, row=2, col=1)
    shade_phases(figure, phases)
    figure.update_xaxes(title="time [s]", range=[0, float(record.time[-1])], row=2, col=1)
    figure.update_yaxes(title="normal force [N]", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title="|f<sub>t</sub>| / (μ f<sub>n</sub>)", range=[0, 1.2], row=2, col=1)
    figure.update_xaxes(title="normal force f<sub>n</sub> [N]", range=[0, most], row=1, col=2)
    figure.update_yaxes(title="tangential force |f<sub>t</sub>| [N]", range=[0, mu * most], row=1, col=2)
    figure.update_xaxes(showticklabels=True, row=1, col=2)
    return figure


_quiet: Final = {"hoverinfo": "skip", "showlegend": False}


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
        for n, (_, start, end) in enumerate(phases):
            if n % 2:
                figure.add_vrect(x0=start, x1=end, fillcolor=faded(GREY, 0.09), line_width=0, layer="below", **place)
        figure.update_yaxes(range=[bottom - room, top + room], **place)
        figure.update_xaxes(title="time [s]", range=[0, float(record.time[-1])], **place)
    figure.update_yaxes(title="joint torque [N m]", row=1, col=1)
    return figure


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
