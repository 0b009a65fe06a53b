"""The report of one perturbed trial: what was drawn, how it went, the motion to be played."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from experiments.model import Model
from experiments.parameter_schema import ParameterFile
from experiments.reports.numbers import number
from experiments.reports.page import Card, Cards, Code, Section, Table, write_report
from experiments.reports.playback import Playback, Track
from experiments.rollout import Tick
from mjx_starleth.terrain import Terrain


def write_trial_report(
    path: Path,
    file: ParameterFile,
    answer: Mapping[str, Any],
    units: Mapping[str, str],
    ticks: Tick,
    terrain: Terrain,
    model: Model,
) -> None:
    """One HTML file. answer: the trial as in robustness.json; ticks: its recording, NumPy leaves. Raises UserError."""
    word = "succeeds" if answer["success"] else "fails"
    cards = [
        Card("Trial", str(answer["trial"]), note=f"seed {answer['seed']}"),
        Card("Outcome", word, tone="good" if answer["success"] else "bad"),
        Card("Cost", number(answer["cost"])),
    ]
    bodies = ticks.after.bodies
    period = float(ticks.time[1] - ticks.time[0])
    motion = Playback(
        [Track(file.drive, bodies.q, ticks.output.bodies.contact_force)],
        period,
        model.numbers,
        "The motion of this trial, on its own ground. Arrows are contact forces.",
        terrain=terrain,
    )
    drawn = [[name, number(value, 4)] for name, value in answer["drawn"].items()]
    metrics = [[name, number(value, 4), units[name]] for name, value in answer["metrics"].items()]
    sections = [
        Section("Result", [Cards(cards)]),
        Section("The motion", [motion]),
        Section("What was drawn", [Table(["Perturbation", "Value"], drawn, "This trial's numbers.", numeric=(1,))]),
        Section("Figures", [Table(["Figure", "Value", "Unit"], metrics, "How it went.", numeric=(1,))]),
        Section("How to repeat it", [Code(answer["command"])]),
    ]
    title = f"Trial {answer['trial']} of {file.task.replace('_', ' ')}"
    write_report(path, title, f"{file.robot} · {file.drive} drive · model {model.hash()}", sections)
