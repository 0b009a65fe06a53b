"""What a log of series-elastic drives says, and of the bodies that they move: the robot, or one joint on a bench."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.blocks import add_products
from experiments.measurement.evidence.bodies_of_log import BodiesOfLog
from experiments.measurement.evidence.body_evidence import BodyEvidence
from experiments.measurement.evidence.drive_evidence import DriveEvidence
from experiments.measurement.evidence.drive_ripple import ripple_lines
from experiments.measurement.evidence.drives_of_log import SHIFT_PRIOR, DrivesOfLog
from experiments.measurement.evidence.features import Change, Products, Seeds
from experiments.measurement.evidence.load_evidence import LoadEvidence
from experiments.measurement.evidence.log_evidence import LocalPart, Point
from experiments.measurement.evidence.parts import Part, Rest
from experiments.measurement.evidence.row_motion import Inputs, MeasuredMotion, RowMotion

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class RobotEvidence:
    """The drives and the bodies of one log, where it shows them; an `Evidence`."""

    name: str
    atoms: Atoms
    drive: DriveEvidence | None
    body: BodyEvidence | LoadEvidence | None
    blocks: int
    period: float
    model_x: Array  # (n,)

    rigid = False

    @cached_property
    def _drives(self) -> DrivesOfLog | None:
        return None if self.drive is None else DrivesOfLog(self.drive, self.atoms, self.blocks)

    @cached_property
    def _bodies(self) -> BodiesOfLog | None:
        return None if self.body is None else BodiesOfLog(self.body, self.atoms, self.blocks, self.period)

    @property
    def _shown(self) -> tuple[DrivesOfLog | BodiesOfLog, ...]:
        return tuple(one for one in (self._drives, self._bodies) if one is not None)

    @property
    def not_judged(self) -> str:
        """What the log does not show, in a sentence or two; empty where it shows all."""
        return " ".join(filter(None, (self._part_not_judged(), self._joints_not_judged())))

    def _part_not_judged(self) -> str:
        if self.body is None:
            return (
                f"Only the drives of {self.name} are judged: for bodies and contact log joint_torque of every joint "
                "and, on the ground, base_position, base_orientation and foot_contact."
            )
        if self.drive is None:
            return f"Only the bodies of {self.name} are judged: for the drives log their commands and motor_position."
        return ""

    def _joints_not_judged(self) -> str:
        if self.drive is None:
            return ""
        each = zip(self.atoms.joint_names, self.drive.used.any((0, 2)), strict=True)
        dark = ", ".join(name for name, told in each if not told)
        needed = "joint_position, joint_torque, motor_position and a command"
        return f"Drives not judged, for each needs {needed} in the log: {dark}." if dark else ""

    @property
    def standing(self) -> bool:
        """Whether the log shows the robot on the ground."""
        return isinstance(self.body, BodyEvidence) and not self.body.replay.clamped

    @property
    def parts(self) -> tuple[Part, ...]:
        return tuple(one.part for one in self._shown)

    def rests(self, point: Point) -> tuple[Rest, ...]:
        return tuple(one.rest(point) for one in self._shown)

    def motions(self, point: Point) -> tuple[RowMotion, ...]:
        return tuple(one.motion(point) for one in self._shown)

    def inputs(self, point: Point) -> tuple[Inputs, ...]:
        return tuple(one.inputs(point) for one in self._shown)

    def measured_motion(self) -> MeasuredMotion | None:
        return None if self._drives is None else self._drives.measured_motion()

    def start(self) -> Point:
        """Where every fit begins: the model's own effects, nothing else off."""
        channels = 0 if self.body is None else len(self.body.channels)
        return Point(self.model_x, np.zeros(len(self.atoms.joint_names)), np.zeros(channels))

    def without(self, rows: Array) -> "RobotEvidence":
        """The same log, the drives not judged on these rows (rows, 1 or J, 1 or 3)."""
        return replace(self, drive=replace(self.drive, used=self.drive.used * ~rows))

    def seeds_at(self, point: Point) -> Seeds:
        """Starts of shape parameters that what is left at a point brings."""
        if self.drive is None or "torque_ripple" not in {effect.name for effect in self.atoms.effects}:
            return {}
        lines = ripple_lines(self.drive, self.drive_residual([point])[0])
        return {"torque_ripple": tuple({"harmonic": harmonic} for harmonic in lines)}

    def drive_residual(self, points: list[Point]) -> Array:
        """(H, T, J, 3) in units of the floor."""
        return self._drives.residual(points)

    def body_residual(self, points: list[Point]) -> Array:
        """(H, N, C) in units of the floor."""
        return self._bodies.residual(points)

    def time_of_body(self) -> Array:
        """Time of each residual of the bodies (N,), s from the log's start."""
        return self._bodies.time()

    def chi2(self, points: list[Point]) -> Array:
        """Sum of squared residuals, body rows thinned to independent ones: (H, blocks)."""
        return sum(one.part.chi2(one.residual(points), self.blocks) for one in self._shown)

    def weight(self) -> Array:
        """Expected chi^2 of noise alone per block (blocks,)."""
        return sum(part.weight(self.blocks) for part in self.parts)

    def constant_errors(self, at: Point) -> Array:
        """What the channels' constant errors add to chi^2 beside the residuals, (blocks, C)."""
        return np.zeros((self.blocks, 0)) if self._bodies is None else self._bodies.constant_errors(at)

    def products(self, at: Point, changes: list[Change]) -> Products:
        """Inner products of the features of `changes`, of this log's own nuisances and of the residual at a point."""
        sizes = [self.atoms.of(c.effect.name)[0].size for c in changes]
        start = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        shift0 = start[-1]
        offset0 = shift0 + len(self.atoms.joint_names)
        last = offset0 + len(at.offset)
        gram = np.zeros((self.blocks, last + 1, last + 1))
        if self._drives is not None:
            self._drives.add_products(gram, at, changes, start[:-1], shift0)
        if self._bodies is not None:
            self._bodies.add_products(gram, at, changes, start[:-1], offset0)
        prior = np.zeros(last + 1)
        prior[shift0:last] = 1.0  # shifts and offsets come in units of their standard deviations
        return Products(gram, tuple(start[:-1]), tuple(range(shift0, last)), prior)

    def local(self, at: Point, directions: Array) -> Array:
        """Gram matrices (blocks, c, c) of a few directions (k, n) at a point: directions, shifts, offsets, residual."""
        offset0, last = self._places(at, directions)
        gram = np.zeros((self.blocks, last + 1, last + 1))
        if self._drives is not None:
            self._drives.add_local(gram, at, directions, last)
        if self._bodies is not None:
            part = self._bodies.local_part(at, directions, offset0, last)
            add_products(gram, part.columns, part.index, part.block)
        return gram

    def local_parts(self, at: Point, directions: Array) -> list[LocalPart]:
        """The same before products are taken: the columns of the drives, (c, T, J, 3), and the bodies', (c, N, C)."""
        offset0, last = self._places(at, directions)
        parts = []
        if self._drives is not None:
            parts.append(self._drives.local_part(at, directions, last))
        if self._bodies is not None:
            parts.append(self._bodies.local_part(at, directions, offset0, last))
        return parts

    def _places(self, at: Point, directions: Array) -> tuple[int, int]:
        """Places of the first offset and of the residual, after the directions and the shifts."""
        offset0 = len(directions) + len(at.shift)
        return offset0, offset0 + len(at.offset)

    def nuisances(self, z: Array) -> tuple[Array, Array]:
        """Coefficients of a gram's nuisance columns as changes of shifts (J,) and offsets (C,)."""
        joints = len(self.atoms.joint_names)
        return z[:joints] * SHIFT_PRIOR, z[joints:] * self._offset_scale()

    def coefficients(self, at: Point) -> Array:
        """Where a point's shifts and offsets stand, in units of their priors: the inverse of `nuisances`."""
        return np.concatenate([at.shift / SHIFT_PRIOR, at.offset / self._offset_scale()])

    def _offset_scale(self) -> Array:
        return np.ones(0) if self._bodies is None else self._bodies.offset_scale()
