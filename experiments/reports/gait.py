"""The report of a tuned gait: contact pattern, speed, torso, drive, ground, the search, and how to repeat it."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from experiments.parameter_schema import ParameterFile
from experiments.reports import gait_figures, motion_figures, search_figures
from experiments.reports.figures import phase_spans
from experiments.reports.numbers import minus, number, percent
from experiments.reports.page import Block, Cards, Figure, Section, Text, write_report
from experiments.reports.parameters import Headlines, gate_card, metric_cards, one_line, parameter_table, provenance
from experiments.reports.playback import Playback, Track
from experiments.reports.recording import GaitRecord, History
from mjx_starleth.numbers import RobotNumbers

STRIDES_SHOWN = 4  # at the end of the recording, where a figure shows single strides
SNAPSHOTS = 8

HEADLINES: Headlines = {
    "survived": ("Kept going", 1.0, "", ""),
    "heading_speed": ("Speed", 1.0, "m/s", ".2f"),
    "flight_fraction": ("In the air", 100.0, "%", ".0f"),
    "cycles": ("Strides", 1.0, "", ".1f"),
    "slip_speed": ("Foot slip", 1e3, "mm/s", ".1f"),
    "cost": ("Cost", 1.0, "", ".2f"),
}


def write_gait_report(
    path: Path | str,
    file: ParameterFile,
    numbers: RobotNumbers,
    record: GaitRecord,
    *,
    history: History | None = None,
) -> None:
    """Write the report of one tuned gait as one HTML file, atomically.

    file: the parameter file just written; record: its nominal trial on the drive it was tuned with. Raises UserError.
    """
    name = file.task.replace("_", " ")
    cards = Cards(metric_cards(file, HEADLINES) + gate_card(file))
    sections = [
        Section("Result", [cards, Text(_summary(file, numbers, record), "lead")]),
        Section("The motion", _motion(numbers, record)),
        Section("Contacts, speed, torso", _gait(numbers, record)),
        Section("Ground and drive", _loads(numbers, record)),
        Section("The search", _search(file, history)),
        Section("How to repeat it", provenance(file)),
    ]
    write_report(path, name.capitalize(), one_line(file), sections)


def stride_duration(record: GaitRecord) -> float:
    """Mean duration of the whole strides recorded, s; the recording's if there is none."""
    starts = np.flatnonzero(np.diff(record.phase) > 0)[1:]
    if len(starts) < 2:
        return float(record.time[-1])
    return float(record.time[starts[-1]] - record.time[starts[0]]) / (len(starts) - 1)


def last_strides(record: GaitRecord, count: int = STRIDES_SHOWN) -> list[tuple[str, float, float]]:
    """(number, start, end) of the last whole strides; the whole recording if there is none."""
    names = [str(k) for k in range(int(record.phase.max()) + 1)]
    whole = phase_spans(record.time, record.phase, names)[1:-1]
    return whole[-count:] or [("", 0.0, float(record.time[-1]))]


def cut(record: GaitRecord, start: float, end: float) -> GaitRecord:
    """The samples from start to end, s."""
    here = (record.time >= start) & (record.time <= end)
    arrays = {f.name: getattr(record, f.name)[here] for f in fields(record) if f.name != "drive"}
    return replace(record, **arrays)


def _summary(file: ParameterFile, numbers: RobotNumbers, record: GaitRecord) -> str:
    strides = last_strides(record)
    late = cut(record, strides[0][1], strides[-1][2])
    loaded = np.linalg.norm(late.contact_force, axis=-1) >= numbers.contact.contact_flag_force
    agree = float((loaded == (late.planned_stance > 0.5)).mean())
    flights = [end - start for start, end in gait_figures.stretches(late.time, ~loaded.any(1))]
    text = f"A stride takes {number(stride_duration(record), 2)} s; over the last {len(strides)} strides the feet are "
    text += f"on the ground when planned for {percent(agree)} of the time, and the robot moves forward at "
    text += f"{minus(f'{late.velocity[:, 0].mean():.2f}')} m/s of {minus(f'{late.command[-1, 0]:.2f}')} m/s commanded."
    if flights:
        text += f" All four feet leave the ground for up to {number(max(flights), 2)} s."
    survived = file.metrics.get("survived")
    if survived is not None and not survived.value:
        text += " The robot falls."
    return text


def _motion(numbers: RobotNumbers, record: GaitRecord) -> list[Block]:
    strides = last_strides(record, 2)
    snapshots = np.linspace(strides[0][1], strides[-1][2], SNAPSHOTS).tolist()
    return [
        Playback(
            [Track(record.drive, record.q, record.contact_force)],
            float(record.time[1] - record.time[0]),
            numbers,
            "The gait, to be played and turned. Arrows are contact forces, green well inside the friction cone, yellow "
            "from 80 % of it, red at its edge. Below, the robot from its right side over its last two strides.",
            snapshots=snapshots,
            poster=snapshots[0],
        )
    ]


def _gait(numbers: RobotNumbers, record: GaitRecord) -> list[Block]:
    strides = last_strides(record)
    force = numbers.contact.contact_flag_force
    return [
        Figure(
            gait_figures.hildebrand(record, force, strides),
            f"Contact pattern of the last strides. Grey, planned stance; coloured, feet that press on the ground with "
            f"at least {force:g} N; behind, green where no foot does: flight.",
            time_axis=True,
        ),
        Figure(
            gait_figures.speeds(record, stride_duration(record)),
            "Speed in the plane of the ground: commanded, reached and as the robot’s own filter estimates it from its "
            "IMU and joints.",
            time_axis=True,
        ),
        Figure(
            gait_figures.height_and_pitch(record, numbers.bodies.foot.radius, strides),
            "Height of the torso and of two feet, and pitch of the torso, over the last strides.",
            time_axis=True,
        ),
    ]


def _loads(numbers: RobotNumbers, record: GaitRecord) -> list[Block]:
    strides = last_strides(record)
    late = cut(record, strides[0][1], strides[-1][2])
    forces = motion_figures.contact_forces(late, numbers, strides)
    torques = motion_figures.joint_torques(late, numbers, strides)
    for figure in (forces, torques):
        figure.update_xaxes(range=[strides[0][1], strides[-1][2]], selector={"title.text": "time [s]"})
    return [
        Figure(
            forces,
            "Contact forces over the last strides. Left, normal force of each foot and how much of the friction cone "
            f"is used; right, every sample in the plane of the cone, μ = {numbers.contact.friction:g}.",
        ),
        Figure(
            torques,
            "Joint torques behind the springs, with the signs of the left fore leg; dashed red, the limits of what "
            "the controller asks for.",
        ),
    ]


def _search(file: ParameterFile, history: History | None) -> list[Block]:
    blocks: list[Block] = []
    if history is not None:
        caption = (
            "Convergence. Each stage makes the model harder and starts where the last ended; costs of different stages "
            "do not compare."
        )
        blocks.append(Figure(search_figures.convergence(history), caption))
    caption = "What the cost of the best gait is made of, weights included."
    blocks.append(Figure(search_figures.bars(file.cost_terms, unit="cost"), caption))
    blocks.append(parameter_table(file))
    return blocks
