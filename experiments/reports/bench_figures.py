"""Pictures of a rigid joint's log: effort measured and modelled, what is left over speed, and its spectrum."""

import numpy as np

from experiments.measurement.evidence.joint_evidence import JointEvidence
from experiments.measurement.selection.ladder import Rung
from experiments.reports.figures import line, new_figure
from experiments.reports.page import Block, Figure

COLOURS = ("#7a7a7a", "#c2571a", "#2a6f97")
SHOWN = 1500  # judged rows in the course of the effort


def bench_signals(log: JointEvidence, index: int, first: Rung, last: Rung) -> list[Block]:
    """The effort over time and the residual over speed, with the nominal and the last model."""
    effort, speed = log.measured(), log.filter.thinned(log.log.velocity[None])[0]
    left = [log.filter.thinned(log.predict([rung.fit.points[index]]))[0] for rung in (first, last)]
    rows = slice(0, min(SHOWN, len(effort)))
    time = np.arange(len(effort))[rows] * log.filter.stride * log.period
    course = new_figure(height=360)
    course.add_trace(line(time, effort[rows], "measured", COLOURS[0]))
    course.add_trace(line(time, (effort - left[0])[rows], first.name, COLOURS[1]))
    over_speed = new_figure(height=320)
    over_speed.add_trace(_dots(speed, left[0], first.name, COLOURS[1]))
    if last is not first:
        course.add_trace(line(time, (effort - left[1])[rows], "with the effects", COLOURS[2]))
        over_speed.add_trace(_dots(speed, left[1], "with the effects", COLOURS[2]))
    over_speed.update_xaxes(title="speed, rad/s or m/s")
    over_speed.update_yaxes(title="effort left, N m or N")
    return [
        Figure(
            course,
            f"{log.name}: effort, filtered below {log.filter.frequency:.0f} Hz, and what the model asks for.",
            True,
        ),
        Figure(over_speed, f"{log.name}: what is left of the effort over the joint's speed."),
    ]


def bench_spectrum(log: JointEvidence, index: int, rungs: tuple[Rung, ...]) -> list[Block]:
    """Power of the residual over frequency, in units of the floor."""
    figure = new_figure(height=320)
    for rung, colour in zip(rungs, COLOURS[1:]):
        r = log.residual([rung.fit.points[index]])[0]
        power = np.abs(np.fft.rfft(r)) ** 2 / len(r)
        frequency = np.fft.rfftfreq(len(r), log.filter.stride * log.period)
        bins = np.geomspace(max(frequency[1], 0.05), frequency[-1], 50)
        place = np.digitize(frequency, bins)
        mean = [power[place == b].mean() if (place == b).any() else np.nan for b in range(1, len(bins))]
        figure.add_trace(line(bins[:-1], np.array(mean), rung.name, colour))
    figure.update_xaxes(type="log", title="Hz")
    figure.update_yaxes(type="log", title="residual power, 1 = floor")
    return [Figure(figure, f"{log.name}: spectrum of what is left of the effort.")]


def _dots(x: np.ndarray, y: np.ndarray, name: str, colour: str) -> dict:
    return {
        "type": "scattergl",
        "x": x,
        "y": y,
        "mode": "markers",
        "name": name,
        "marker": {"size": 2, "color": colour},
    }
