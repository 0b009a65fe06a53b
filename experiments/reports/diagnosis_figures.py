"""Pictures of a diagnosis: the error ladder, where the model fails before and after, signals, what is left."""

import numpy as np
import plotly.graph_objects as go

from experiments.measurement.diagnose import Diagnosis
from experiments.measurement.evidence.drive_replay import CHANNELS as DRIVE_CHANNELS
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.evidence.robot_evidence import RobotEvidence
from experiments.measurement.fits.misfit import Misfit
from experiments.measurement.logs.log import SIGNALS
from experiments.measurement.regimes import REGIMES, regimes
from experiments.measurement.selection.verdict import held_out_error
from experiments.reports.bench_figures import bench_signals
from experiments.reports.comparison import heat
from experiments.reports.figures import BLUE, GREY, ORANGE, line, new_figure
from experiments.reports.page import Block, Columns, Figure, Table

SHOWN = 1200  # samples of a signal in a figure
BINS = 60  # of a spectrum
LOWEST = 0.05  # Hz
WIDE = 8.0  # ratio of errors from which the ladder's axis is logarithmic
BEFORE, AFTER = "nominal model", "with the effects"


def ladder(found: Diagnosis) -> Block:
    """The worst channel, and the RMS over all, on the blocks that each rung was not fitted to."""
    names = [rung.name for rung in found.selection.ladder]
    worst = [held_out_error(found.logs, rung.proof) for rung in found.selection.ladder]
    figure = new_figure(height=320)
    text = [f"{error:.2f}" for error in worst]
    figure.add_trace(go.Bar(x=names, y=worst, marker_color=BLUE, text=text, textposition="outside", width=0.5))
    figure.add_hline(y=1.0, line_dash="dot", annotation_text="sensor noise")
    figure.update_yaxes(title="residual over noise, held out")
    top = max(*worst, 1.0)
    if top > WIDE * min(worst):  # the last steps, down to the noise, would not be seen
        figure.update_yaxes(type="log", dtick=1, range=[np.log10(0.5), np.log10(2.0 * top)])
    else:
        figure.update_yaxes(range=[0, 1.2 * top])
    caption = "Worst channel of the replay after each added effect, on parts of the logs not fitted to."
    if found.selection.fit.effects and not found.effects:
        caption += " What was tried leaves too much, or only imitates what is missing: it is not believed."
    return Figure(figure, caption)


def maps(found: Diagnosis) -> list[Block]:
    """Joint by regime and joint by channel, before and after side by side; bodies and contact as a table."""
    blocks: list[Block] = []
    first, last = found.selection.ladder[0].fit, found.selection.fit
    for i, (log, before, after) in enumerate(zip(found.logs, found.before, found.after, strict=True)):
        joints = log.atoms.joint_names
        sides = [(BEFORE, before, first)] + ([(AFTER, after, last)] if found.selection.fit.effects else [])
        columns = []
        for label, misfit, fit in sides:
            by_regime = regimes(log, fit, i)
            column = []
            if by_regime is not None:
                column.append(Figure(heat(by_regime, REGIMES, joints), f"{log.name}, {label}: residual over noise."))
            if misfit.drive is not None:
                by_channel = heat(misfit.drive, DRIVE_CHANNELS, joints)
                column.append(Figure(by_channel, f"{log.name}, {label}: the drives' channels."))
            columns.append(column)
        if any(columns):
            blocks.append(Columns(columns))
        blocks += _rest(log, before, after)
    return blocks


def _rest(log: Evidence, before: Misfit, after: Misfit) -> list[Block]:
    """Channels that belong to no drive."""
    rows = []
    for part in log.parts:
        if part.name != "drive":
            sizes = (misfit.of(part).ravel() for misfit in (before, after))
            rows += [(name, b, a) for name, b, a in zip(part.channels.ravel(), *sizes, strict=True) if np.isfinite(b)]
    if not rows:
        return []
    header = ("channel of bodies and contact", BEFORE, AFTER)
    caption = f"{log.name}: residual over noise of what was measured at the joints, the torso and the feet."
    return [Table(header, [(n, f"{b:.2f}", f"{a:.2f}") for n, b, a in rows], caption, numeric=(1, 2))]


def signals(found: Diagnosis) -> list[Block]:
    """Of each part of the plant, the channel that the nominal model misses most, before and after."""
    shown = {"drive": _drive_signal, "body": _body_signal, "effort": bench_signals}
    return [
        block
        for i, log in enumerate(found.logs)
        for part in log.parts
        if np.isfinite(found.before[i].of(part)).any()
        for block in shown[part.name](found, i, log)
    ]


def _drive_signal(found: Diagnosis, i: int, log: RobotEvidence) -> list[Block]:
    j, c = np.unravel_index(np.nanargmax(found.before[i].drive), found.before[i].drive.shape)
    rows = slice(0, min(SHOWN, log.drive.rows))
    time = np.arange(log.drive.rows)[rows] * log.period
    figure = new_figure(height=360)
    figure.add_trace(line(time, log.drive.measured[rows, j, c], "measured", GREY))
    for name, fit, colour in _fits(found):
        point = fit.points[i]
        predicted = log.drive.predict(point.x[None], point.shift[None])[0]
        figure.add_trace(line(time, predicted[rows, j, c], name, colour))
    figure.update_xaxes(title="s")
    figure.update_yaxes(title=SIGNALS[DRIVE_CHANNELS[c]].unit)
    name = f"{DRIVE_CHANNELS[c]} of {log.atoms.joint_names[j]}"
    return [Figure(figure, f"{log.name}: {name}, the drives' channel that the nominal model misses most.", True)]


def _body_signal(found: Diagnosis, i: int, log: RobotEvidence) -> list[Block]:
    c = int(np.nanargmax(found.before[i].body))
    figure = new_figure(height=320)
    time = log.time_of_body()
    for name, fit, colour in _fits(found):
        left = log.body_residual([fit.points[i]])[0][:, c]
        figure.add_trace(line(time, np.where(log.body.used[:, c] > 0, left, np.nan), name, colour))
    figure.update_xaxes(title="s")
    figure.update_yaxes(title="left over, in noise deviations")
    caption = f"{log.name}: {log.body.channels[c]}, what the equations of motion leave of it where it is measured."
    return [Figure(figure, caption, True)]


def spectra(found: Diagnosis) -> list[Block]:
    """Residual power over frequency, before and after; noise alone is at 1. The bodies' residuals are smoothed."""
    blocks: list[Block] = []
    for i, log in enumerate(found.logs):
        motion = log.measured_motion()
        if motion is None:
            continue
        figure = new_figure(height=320)
        for name, fit, colour in _fits(found):
            rest, *_ = log.rests(fit.points[i])
            figure.add_trace(_spectrum(rest.residual, motion.period, name, colour))
        figure.update_xaxes(type="log", dtick=1, title="Hz")
        figure.update_yaxes(type="log", dtick=1, title="residual power, 1 = noise")
        blocks.append(Figure(figure, f"{log.name}: spectrum of the {rest.part.name} residuals; white noise lies at 1."))
    return blocks


def _spectrum(residual: np.ndarray, period: float, name: str, colour: str) -> go.Scatter:
    power = (np.abs(np.fft.rfft(residual, axis=0)) ** 2).mean((1, 2)) / len(residual)
    frequency = np.fft.rfftfreq(len(residual), period)
    bins = np.geomspace(max(frequency[1], LOWEST), frequency[-1], BINS)
    index = np.digitize(frequency, bins)
    mean = [power[index == b].mean() if (index == b).any() else np.nan for b in range(1, len(bins))]
    return line(bins[:-1], np.array(mean), name, colour)


def _fits(found: Diagnosis):
    """The nominal fit, and the last one where effects were added: (name, fit, colour)."""
    yield BEFORE, found.selection.ladder[0].fit, ORANGE
    if found.selection.fit.effects:
        yield AFTER, found.selection.fit, BLUE
