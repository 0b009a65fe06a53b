"""The report of `tune squat_jump`: the jump, the drive, the ground, the search, and how to repeat it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.parameter_schema import ParameterFile
from experiments.reports import motion_figures, search_figures
from experiments.reports.figures import phase_spans
from experiments.reports.numbers import minus, number, percent
from experiments.reports.page import Block, Card, Cards, Figure, Section, Table, Text, write_report
from experiments.reports.parameters import Headlines, gate_card, metric_cards, one_line, parameter_table, provenance
from experiments.reports.playback import Playback, Track
from experiments.reports.recording import (
    JUMP_PHASES,
    SATURATIONS,
    History,
    JumpRecord,
    Sensitivity,
    saturations,
)
from mjx_starleth.names import JOINTS
from mjx_starleth.numbers import RobotNumbers

PAPER_APEX = 0.76  # m, 150 % of the leg's length (paper VI.B)
SNAPSHOTS = 8
AFTER_LANDING = 0.35  # s of landing and standing that the strip of pictures shows
AFTER_TAKE_OFF = 0.03  # s of the flight shown where the launch is the subject

HEADLINES: Headlines = {
    "apex_height": ("Apex of the torso", 1.0, "m", ".2f"),
    "landed": ("Landed", 1.0, "", ""),
    "rebound_time": ("Rebound", 1e3, "ms", ".0f"),
    "slip_distance": ("Foot slip", 1e3, "mm", ".1f"),
    "cost": ("Cost", 1.0, "", ".2f"),
}


def write_jump_report(
    path: Path | str,
    file: ParameterFile,
    numbers: RobotNumbers,
    record: JumpRecord,
    *,
    ideal: JumpRecord | None = None,
    history: History | None = None,
    sensitivities: Sequence[Sensitivity] = (),
    refinement: np.ndarray | None = None,
) -> None:
    """Write the report of one tuned jump as one HTML file, atomically.

    file: the parameter file just written; record: its jump on the drive it was tuned with; ideal: the same
    parameters on the ideal drive, same samples; sensitivities: change of the apex height [m];
    refinement: true cost before and after each of its steps. Raises UserError.
    """
    sections = [
        Section("Result", [_cards(file, record, ideal), Text(_summary(file, numbers, record, ideal), "lead")]),
        Section("The motion", _motion(numbers, record, ideal)),
        Section("The drive", _drive(numbers, record)),
        Section("The ground", _ground(numbers, record)),
        Section("The search", _search(file, history, sensitivities, refinement)),
        Section("How to repeat it", provenance(file)),
    ]
    write_report(path, "Squat jump", one_line(file), sections)


def leg_length(numbers: RobotNumbers) -> float:
    """HAA axis to foot centre of a stretched leg, m."""
    bodies = numbers.bodies
    return bodies.hip.length + bodies.thigh.length + bodies.foot.centre_from_knee


def _cards(file: ParameterFile, record: JumpRecord, ideal: JumpRecord | None) -> Cards:
    cards = metric_cards(file, HEADLINES)
    if ideal is not None:
        note = f"{ideal.apex - record.apex:+.2f} m with the same parameters"
        cards.append(Card("On the ideal drive", f"{ideal.apex:.2f}", "m", minus(note)))
    return Cards(cards + gate_card(file))


def _summary(file: ParameterFile, numbers: RobotNumbers, record: JumpRecord, ideal: JumpRecord | None) -> str:
    share = record.apex / leg_length(numbers)
    text = (
        f"The torso rises to {record.apex:.2f} m, {percent(share)} of the leg’s length"
        f" (the robot of the paper: {PAPER_APEX:.2f} m)."
    )
    rebound, landed = file.metrics.get("rebound_time"), file.metrics.get("landed")
    if landed is not None and landed.value:
        text += " It lands on its feet"
        if rebound is not None:
            text += (
                " without a second take-off"
                if rebound.value == 0
                else f", off the ground again for {number(rebound.value)} s"
            )
        text += " and stands still."
    elif landed is not None:
        text += " It does not land and stand still."
    if ideal is not None:
        gain = round(100 * (ideal.apex - record.apex))
        text += f" With a perfect torque source in place of the drives the same parameters reach {ideal.apex:.2f} m"
        text += f": {gain} cm are lost to motors, gears and springs." if gain > 0 else "."
    return text


def _motion(numbers: RobotNumbers, record: JumpRecord, ideal: JumpRecord | None) -> list[Block]:
    tracks = [Track(record.drive, record.q, record.contact_force)]
    if ideal is not None and len(ideal.time) == len(record.time):
        tracks.append(Track(f"Ghost on the {ideal.drive} drive", ideal.q, ideal.contact_force))
    motions = [record] if ideal is None else [record, ideal]
    desired = np.where(record.phase == JUMP_PHASES.index("flight"), np.nan, record.desired_height)
    apex_time = float(record.time[record.q[:, 2].argmax()])
    lines = "Thin lines: the left fore foot." + (
        "" if ideal is None else " Orange: the same parameters without drive train."
    )
    return [
        Playback(
            tracks,
            float(record.time[1] - record.time[0]),
            numbers,
            "The jump, to be played and turned. Arrows are contact forces, green well inside the friction cone, yellow "
            "from 80 % of it, red at its edge. Below, the robot from its right side at equal steps of time, the height "
            "of the torso, and which feet are on the ground.",
            spans=_phases(record),
            snapshots=_snapshot_times(record),
            poster=apex_time,
        ),
        Figure(
            motion_figures.heights(motions, desired, _phases(record), numbers.bodies.foot.radius),
            f"Height of the torso and of the left fore foot. {lines} Desired is what the parameters ask for in the "
            "launch, and the safe landing after it. Click to move the playback there.",
            time_axis=True,
        ),
    ]


def _phases(record: JumpRecord) -> list[tuple[str, float, float]]:
    return phase_spans(record.time, record.phase, JUMP_PHASES)


def _snapshot_times(record: JumpRecord) -> list[float]:
    launch, landing = record.start_of("launch"), record.start_of("landing")
    last = float(record.time[-1])
    start = 0.0 if launch is None else float(record.time[launch])
    end = last if landing is None else min(last, float(record.time[landing]) + AFTER_LANDING)
    return np.linspace(start, end, SNAPSHOTS).tolist()


def _drive(numbers: RobotNumbers, record: JumpRecord) -> list[Block]:
    launch = record.time <= record.time[record.take_off]
    error = (record.motor_velocity - record.commanded_velocity)[launch]
    rms = [float(np.sqrt(np.mean(error[:, k] ** 2))) for k in range(3)]
    joints = ", ".join(f"{joint} {number(value, 2)}" for joint, value in zip(JOINTS, rms, strict=True))
    limited = saturations(record, numbers)
    rows = []
    for k, joint in enumerate(JOINTS):
        # the worst leg
        shares = [max(float(limited[name][launch, leg * 3 + k].mean()) for leg in range(4)) for name in SATURATIONS]
        current = np.abs(record.current[launch, k::3]).max()
        voltage = np.abs(record.voltage[launch, k::3]).max()
        rows.append([joint, *(percent(share) for share in shares), number(current), number(voltage)])
    return [
        Figure(
            motion_figures.gear_velocities(record, numbers, float(record.time[record.take_off]) + AFTER_TAKE_OFF),
            "Gear velocities of the left fore leg until take-off: what the torque loop desires, what remains after "
            "the limits of speed and power, and what the motor reaches. Bars below mark where a limit of the drive "
            f"holds the joint back. RMS between commanded and reached, all legs: {joints} rad/s.",
            time_axis=True,
        ),
        Table(
            ["Joint", *(f"at {name} limit" for name in SATURATIONS), "largest current [A]", "largest voltage [V]"],
            rows,
            "Share of the time until take-off that the drive spends at each limit, for the leg that spends most.",
            numeric=range(1, 7),
        ),
        Figure(
            motion_figures.joint_torques(record, numbers, _phases(record)),
            "Joint torques behind the springs, with the signs of the left fore leg; dashed red, the limits of what "
            "the controller asks for; the knee’s end stop may carry more. In flight the joints are in position mode.",
            time_axis=True,
        ),
    ]


def _ground(numbers: RobotNumbers, record: JumpRecord) -> list[Block]:
    return [
        Figure(
            motion_figures.contact_forces(record, numbers, _phases(record)),
            "Contact forces. Left, normal force of each foot and how much of the friction cone is used (a foot that "
            f"carries less than {numbers.contact.contact_flag_force:g} N is left out); right, every sample in the "
            f"plane of the cone, μ = {numbers.contact.friction:g}. A point on the dashed line is a foot that slips.",
        )
    ]


def _search(
    file: ParameterFile,
    history: History | None,
    sensitivities: Sequence[Sensitivity],
    refinement: np.ndarray | None,
) -> list[Block]:
    blocks: list[Block] = []
    if history is not None:
        blocks.append(
            Figure(
                search_figures.convergence(history),
                "Convergence. Each stage makes the model harder and starts where the last ended; costs of different "
                "stages do not compare. The axis is scaled to the good candidates: a fall costs far more."
                + (
                    ""
                    if history.sigma is None
                    else " Below, the step size of the search as a share of each parameter’s range."
                ),
            )
        )
    if refinement is not None:
        kept = "" if file.search.get("refine_kept") else " Its result did no better on unseen trials and was not kept."
        text = "Refinement by gradients of the smooth rollout: true cost after each step; none is taken that raises it."
        blocks.append(Figure(search_figures.descent(refinement), text + kept))
    blocks.append(
        Figure(
            search_figures.bars(file.cost_terms, unit="cost"),
            "What the cost of the best jump is made of, weights included: below zero is gain, above zero is penalty.",
        )
    )
    blocks.append(parameter_table(file))
    if sensitivities:
        blocks.append(
            Figure(
                search_figures.tornado(sensitivities, "m"),
                "Change of the apex height when one number at a time is changed: what limits the jump stands on top.",
            )
        )
    return blocks
