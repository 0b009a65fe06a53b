"""The report of `starleth diagnose`: the verdict in plain words, the error ladder, the map, the ranking, the signals."""

from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from experiments.measurement.diagnose import Diagnosis
from experiments.measurement.evidence import DRIVE_CHANNELS, Evidence
from experiments.measurement.joint_evidence import JointEvidence
from experiments.measurement.refit import Refitted
from experiments.measurement.selection import best_of_each
from experiments.reports.bench_figures import bench_signals, bench_spectrum
from experiments.reports.comparison import heat
from experiments.reports.figures import line, new_figure
from experiments.reports.page import Block, Card, Cards, Figure, Section, Table, Text, write_report

RANKED = 12
SHOWN = 1200  # samples of a signal in a figure
COLOURS = ("#7a7a7a", "#c2571a", "#2a6f97", "#5b8c5a", "#8a5a83")


def write_diagnosis_report(path: Path, found: Diagnosis) -> None:
    """One HTML file that needs no network. Raises UserError."""
    cards = [Card("Verdict", found.verdict.replace("_", " "), tone="good" if found.effects else "plain")]
    for entry in found.answer["effects"]:
        name, value = next(iter(entry["parameters"].items()))
        low, high = value["ci95"]
        note = f"{name} {value['value']:.4g} {value['unit']} ({low:.4g} to {high:.4g})"
        cards.append(
            Card(f"{entry['effect']} at {entry['where']}", f"{entry['held_out_error_after']:.2f}", "× noise", note)
        )
    cards.append(Card("Left unexplained", f"{100 * found.answer['unexplained_fraction']:.1f}", "%"))
    sections = [
        Section("Result", [Cards(cards), Text(found.text, "lead")]),
        Section("The error ladder", [_ladder(found)]),
        Section("Where the model fails", _maps(found)),
        Section("Which effect", [_ranking(found)]),
        Section("Measured against model", _signals(found)),
        Section("What is left", _spectra(found)),
    ]
    write_report(path, "Diagnosis", ", ".join(log.name for log in found.logs), sections)


def _ladder(found: Diagnosis) -> Block:
    points = sum(log.weight().sum() for log in found.logs)
    names = [name for name, *_ in found.selection.ladder]
    errors = [float(np.sqrt(fit.total / points)) for _, fit, _ in found.selection.ladder]
    figure = new_figure(height=320)
    figure.add_trace(go.Bar(x=names, y=errors, marker_color=COLOURS[2], text=[f"{e:.2f}" for e in errors]))
    figure.add_hline(y=1.0, line_dash="dot", annotation_text="sensor noise")
    figure.update_yaxes(type="log", title="RMS residual over noise")
    return Figure(figure, "Error of the replay after each added effect, down to the noise floor.")


def _maps(found: Diagnosis) -> list[Block]:
    blocks: list[Block] = []
    for log, before, after in zip(found.logs, found.before, found.after, strict=True):
        for label, one in (("before", before), ("after", after)):
            if one.drive is not None:
                joints = log.atoms.joint_names
                caption = f"{log.name}: residual over noise of the drives, {label} adding effects."
                blocks.append(Figure(heat(one.drive.T, DRIVE_CHANNELS, joints), caption))
        body = [] if log.body is None else list(_body_rows(log.body.channels, before.body, after.body))
        if before.effort is not None:
            rows = [("effort", f"{before.worst:.2f}", f"{after.worst:.2f}")]
            blocks.append(Table(("channel of the joint", "before", "after"), rows, f"{log.name}.", numeric=(1, 2)))
        if body:
            rows = [(name, f"{b:.2f}", f"{a:.2f}") for name, b, a in body]
            blocks.append(
                Table(("channel of bodies and contact", "before", "after"), rows, f"{log.name}.", numeric=(1, 2))
            )
    return blocks


def _body_rows(channels, before, after):
    for name, b, a in zip(channels, before, after, strict=True):
        if np.isfinite(b):
            yield name, b, a


def _ranking(found: Diagnosis) -> Block:
    if not found.selection.rankings:
        return Text("Nothing was scored: the model explains the log.")
    best = [s for s in best_of_each(found.selection.rankings[0]) if s.gain > 0][:RANKED]
    rows = [
        (
            s.effect.name,
            s.where,
            f"{s.gain:.0f}",
            ", ".join(f"{k} {v:.3g}" for k, v in s.values.items()),
            s.effect.about,
        )
        for s in best
    ]
    header = ("effect", "best place", "score", "suggested numbers", "meaning")
    return Table(header, rows, "Fall of chi-square that each effect promises, each at its best place.", numeric=(2,))


def _signals(found: Diagnosis) -> list[Block]:
    """The channel that failed most, before and after."""
    blocks: list[Block] = []
    steps = found.selection.ladder
    for i, log in enumerate(found.logs):
        if isinstance(log, JointEvidence):
            blocks += bench_signals(log, i, steps[0], steps[-1])
        if log.drive is None:
            continue
        c, j = np.unravel_index(np.argmax(found.before[i].drive), found.before[i].drive.shape)
        name = f"{DRIVE_CHANNELS[c]} of {log.atoms.joint_names[j]}"
        predicted = [_prediction(log, fit, i)[:, j, c] for _, fit, _ in (steps[0], steps[-1])]
        rows = slice(0, min(SHOWN, log.drive.rows))
        time = np.arange(log.drive.rows)[rows] * log.period
        figure = new_figure(height=360)
        figure.add_trace(line(time, log.drive.measured[rows, j, c], "measured", COLOURS[0]))
        figure.add_trace(line(time, predicted[0][rows], "nominal model", COLOURS[1]))
        if len(steps) > 1:
            figure.add_trace(line(time, predicted[1][rows], "with the effects", COLOURS[2]))
        blocks.append(Figure(figure, f"{log.name}: {name}, the channel that the nominal model misses most.", True))
    return blocks


def _prediction(log: Evidence, fit: Refitted, index: int) -> np.ndarray:
    point = fit.points[index]
    return log.drive.predict(point.x[None], point.shift[None])[0]


def _spectra(found: Diagnosis) -> list[Block]:
    blocks: list[Block] = []
    steps = found.selection.ladder
    shown = (steps[0], steps[-1]) if len(steps) > 1 else tuple(steps[:1])
    for i, log in enumerate(found.logs):
        if isinstance(log, JointEvidence):
            blocks += bench_spectrum(log, i, shown)
        if log.drive is None:
            continue
        figure = new_figure(height=320)
        for k, (name, fit, _) in enumerate(shown):
            r = log.drive_residual([fit.points[i]])[0]
            power = (np.abs(np.fft.rfft(r, axis=0)) ** 2).mean((1, 2)) / len(r)
            frequency = np.fft.rfftfreq(len(r), log.period)
            bins = np.geomspace(max(frequency[1], 0.3), frequency[-1], 60)
            index = np.digitize(frequency, bins)
            mean = [power[index == b].mean() if (index == b).any() else np.nan for b in range(1, len(bins))]
            figure.add_trace(line(bins[:-1], np.array(mean), name, COLOURS[k + 1]))
        figure.update_xaxes(type="log", title="Hz")
        figure.update_yaxes(type="log", title="residual power, 1 = noise")
        blocks.append(Figure(figure, f"{log.name}: spectrum of the drives' residuals; white noise lies at 1."))
    return blocks
