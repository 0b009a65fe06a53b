"""Pictures of a rigid joint's log: effort measured and modelled, and what is left over speed."""

import numpy as np

from experiments.measurement.diagnose import Diagnosis
from experiments.measurement.evidence.joint_evidence import JointEvidence
from experiments.reports.figures import line, new_figure
from experiments.reports.page import Block, Figure

COLOURS = ("#7a7a7a", "#c2571a", "#2a6f97")
SHOWN = 1500  # judged rows in the course of the effort


def bench_signals(found: Diagnosis, index: int, log: JointEvidence) -> list[Block]:
    """The effort over time and the residual over speed, with the nominal and the last model."""
    first, last = found.selection.ladder[0], found.selection.ladder[-1]
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


def _dots(x: np.ndarray, y: np.ndarray, name: str, colour: str) -> dict:
    return {
        "type": "scattergl",
        "x": x,
        "y": y,
        "mode": "markers",
        "name": name,
        "marker": {"size": 2, "color": colour},
    }
