"""What the unexplained rest goes with: the inputs and states that it follows, in sign or in size.

A residual that nothing explains is no noise if it correlates with something. Which, is the best hint at the effect
that the library lacks. Correlations are judged by the scatter of the blocks' products, which holds under coloured
residuals.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from experiments.measurement.evidence.blocks import sum_blocks
from experiments.measurement.evidence.drive_replay import CHANNELS as DRIVE_CHANNELS
from experiments.measurement.evidence.joint_evidence import JointEvidence
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.evidence.states import JointMotion, bench_motion, body_motion, body_rows, drive_motion
from experiments.measurement.fits.fit_types import Refitted

Array = np.ndarray

ABOVE = 1.3  # residual over noise from which a channel has something left to explain
SURE = 3.0  # standard deviations, by the blocks' scatter
LEAST = 0.15  # correlation below which nobody could see it
BY_SIZE = 0.7  # of a correlation counts where only sizes go together, which tells less
MOST = 5  # hints given
STILL = 0.05  # of the largest speed: no direction
WORDS = {"follows": "goes with {}", "grows": "is larger where {} is large"}


class Hint(NamedTuple):
    """A channel's rest and what it goes with. way: `follows` the input, or `grows` with it, whatever its sign."""

    log: str
    channel: str
    over_noise: float
    input: str
    way: str
    correlation: float

    def in_words(self) -> str:
        return f"{self.channel} {WORDS[self.way].format('the ' + self.input)} (correlation {self.correlation:+.2f})"


def hints(logs: Sequence[Evidence | JointEvidence], fit: Refitted) -> list[Hint]:
    """The strongest hint of each channel that a fit leaves above the noise, the worst channels first."""
    found = []
    for log, point in zip(logs, fit.points, strict=True):
        for name, rest, used, block, inputs in _channels(log, point):
            size = float(np.sqrt((rest**2).sum() / max(used.sum(), 1.0)))
            if size > ABOVE and (best := _best(rest, used, block, log.blocks, inputs)):
                found.append(Hint(log.name, name, round(size, 3), *best))
    return sorted(found, key=lambda h: -h.over_noise * abs(h.correlation))[:MOST]


def _best(rest: Array, used: Array, block: Array, blocks: int, inputs: Mapping[str, Array]):
    """(input, way, correlation) of the input that a rest (N,) goes with most clearly; None if with none."""
    judged = []
    for name, x in inputs.items():
        judged.append((name, "follows", *_correlation(rest, x, used, block, blocks)))
        if not name.startswith("direction"):
            judged.append((name, "grows", *_correlation(np.abs(rest), np.abs(x), used, block, blocks)))
    sure = [one for one in judged if one[3] > SURE and abs(one[2]) > LEAST]
    if not sure:
        return None
    name, way, correlation, _ = max(sure, key=lambda one: abs(one[2]) * (BY_SIZE if one[1] == "grows" else 1.0))
    return name, way, round(correlation, 3)


def _correlation(y: Array, x: Array, used: Array, block: Array, blocks: int) -> tuple[float, float]:
    """Correlation of two series (N,) on the rows that count, and how many deviations it is from chance."""
    count = max(used.sum(), 1.0)
    y = (y - (y * used).sum() / count) * used
    x = (x - (x * used).sum() / count) * used
    both = np.sqrt((y @ y) * (x @ x))
    if not both > 0:
        return 0.0, 0.0
    parts = sum_blocks((x * y)[None], block, blocks)[0]
    spread = np.sqrt(blocks) * parts.std(ddof=1) if blocks > 1 else np.inf
    return float(parts.sum() / both), float(abs(parts.sum()) / max(spread, 1e-12 * both))


def _channels(log: Evidence | JointEvidence, point) -> Iterator[tuple[str, Array, Array, Array, dict[str, Array]]]:
    """Each channel: name, rest over noise (N,), rows that count, their blocks, and what it may go with."""
    if isinstance(log, JointEvidence):
        yield "effort", log.residual([point])[0], log.used, log.block_of_rows(), _of_joint(bench_motion(log), 0)
        return
    if log.drive is not None:
        yield from _drive_channels(log, point)
    if log.body is not None:
        yield from _body_channels(log, point)


def _drive_channels(log: Evidence, point) -> Iterator[tuple]:
    rest, rows = log.drive_residual([point])[0], slice(0, log.drive.rows)
    d, motion = log.drive.log, drive_motion(log, point)
    for j, joint in enumerate(log.atoms.joint_names):
        inputs = _of_joint(motion, j)
        far = np.where(d.position_mode > 0.5, d.command_position - d.joint_position, d.command_torque - d.joint_torque)
        inputs["distance to the command"] = far[rows, j].astype(float)
        inputs["motor current"] = d.motor_current[rows, j].astype(float)
        for c, signal in enumerate(DRIVE_CHANNELS):
            used = log.drive.used[:, j, c]
            yield f"{signal}/{joint}", rest[:, j, c], used, log.block_of_drive(), inputs


def _body_channels(log: Evidence, point) -> Iterator[tuple]:
    rest = log.body_residual([point])[0]
    motion = body_motion(log)
    for c, channel in enumerate(log.body.channels):
        place = channel.partition("/")[2]
        names = log.atoms.joint_names
        inputs = _of_joint(motion, names.index(place)) if place in names else _of_torso(log)
        yield channel, rest[:, c], log.body.used[:, c], log.block_of_body(), inputs


def _of_torso(log: Evidence) -> dict[str, Array]:
    table, at = log.body.log, body_rows(log)
    q, u = table.q[at].astype(float), table.u[at].astype(float)
    along = {f"torso's velocity along {axis}": u[:, i] for i, axis in enumerate("xyz")}
    turn = {f"torso's turning rate about {axis}": u[:, 3 + i] for i, axis in enumerate("xyz")}
    tilt = {f"torso's tilt about {axis}": 2.0 * q[:, 4 + i] for i, axis in enumerate("xy")}
    push = {f"torso's acceleration along {axis}": table.du[at, i].astype(float) for i, axis in enumerate("xyz")}
    return {**along, **turn, **tilt, **push, "torso's height": q[:, 2], "time": np.arange(len(at), dtype=float)}


def _of_joint(motion: JointMotion, j: int) -> dict[str, Array]:
    position, velocity, load = (x[:, j] for x in motion)
    still = STILL * np.abs(velocity).max(initial=0.0)
    return {
        "joint position": position,
        "joint speed": velocity,
        "direction of motion": np.where(np.abs(velocity) > still, np.sign(velocity), 0.0),
        "load": load,
        "time": np.arange(len(position), dtype=float),
    }
