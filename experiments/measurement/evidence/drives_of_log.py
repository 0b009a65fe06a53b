"""The drives of one log as a fit asks for them: residuals and what numbers change in them, with a memory of replays."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.blocks import BLOCK, add_products
from experiments.measurement.evidence.drive_evidence import FELT_BY_DRIVES, DriveEvidence
from experiments.measurement.evidence.drive_replay import CHANNELS
from experiments.measurement.evidence.features import Change, changed
from experiments.measurement.evidence.log_evidence import LocalPart, Point
from experiments.measurement.evidence.parts import Part, Rest
from experiments.measurement.evidence.remembered import Remembered
from experiments.measurement.evidence.row_motion import Inputs, MeasuredMotion, RowMotion, row_motion

Array = np.ndarray

SHIFT_STEP = 1e-4  # rad
SHIFT_PRIOR = 3e-4  # rad, standard deviation of what the first motor angle may be wrong by
FAST = 1.0  # rad/s of a joint


@dataclass(frozen=True, eq=False)
class DrivesOfLog:
    """J drives on T rows, with three channels each."""

    drive: DriveEvidence
    atoms: Atoms
    blocks: int
    known: Remembered = field(default_factory=Remembered)

    @cached_property
    def part(self) -> Part:
        names = self.atoms.joint_names
        channels = np.array([[f"{signal}/{name}" for signal in CHANNELS] for name in names])
        joint, time = np.arange(len(names))[:, None], np.arange(self.drive.rows) * self.drive.period
        block = np.minimum((time / BLOCK).astype(int), self.blocks - 1)
        return Part("drive", channels, joint, self.drive.used, block, FELT_BY_DRIVES)

    def residual(self, points: list[Point]) -> Array:
        """(H, T, J, 3) in units of the floor. Points that differ only in what the drives do not feel are run once."""
        xs, shifts = np.stack([p.x for p in points]), np.stack([p.shift for p in points])
        felt = np.concatenate([xs[:, self.atoms.touching(FELT_BY_DRIVES)], shifts], 1)
        return self.known.ask(felt, lambda new: self.drive.residual(xs[new], shifts[new]))

    def rest(self, point: Point) -> Rest:
        return Rest(self.part, self.residual([point])[0], np.zeros((self.blocks, 1, 1)))

    def motion(self, point: Point) -> RowMotion:
        """The velocity is the motor's.

        The load is what the replay at a point predicts, on rows that count: the measured one has the noise of the
        residual itself, which goes with any law that is multiplied by it.
        """
        table, rows, c = self.drive.log, slice(0, self.drive.rows), CHANNELS.index("joint_torque")
        error = self.residual([point])[0][..., c] * self.drive.floor[:, c]
        return row_motion(table.joint_position[rows], table.motor_velocity[rows], table.joint_torque[rows] + error)

    def inputs(self, point: Point) -> Inputs:
        d, rows = self.drive.log, slice(0, self.drive.rows)
        far = np.where(d.position_mode > 0.5, d.command_position - d.joint_position, d.command_torque - d.joint_torque)
        own = {"distance to the command": far[rows].astype(float), "motor current": d.motor_current[rows].astype(float)}
        return Inputs(self.motion(point).inputs() | own)

    def measured_motion(self) -> MeasuredMotion:
        d, rows = self.drive.log, slice(0, self.drive.rows)
        tables = (d.joint_velocity[rows], d.joint_torque[rows], d.position_mode[rows])
        return MeasuredMotion(*tables, self.drive.period, FAST)

    def add_products(self, gram: Array, at: Point, changes: list[Change], start: Array, shift0: int) -> None:
        """Add the inner products of features, shifts and residual to gram (blocks, c, c).

        start (changes,), shift0: first columns of each feature, and of the shifts.
        """
        at = at._replace(shift=np.zeros_like(at.shift))  # where the priors of the nuisances have their centre
        points = [at, at._replace(shift=at.shift + SHIFT_STEP)]
        points += [at._replace(x=changed(self.atoms, at.x, change)) for change in changes]
        r = self.residual(points)
        # a change too large for the replay says nothing
        moved = np.nan_to_num(r[2:] - r[:1], nan=0.0, posinf=0.0, neginf=0.0)
        columns = np.concatenate([moved, (r[1:2] - r[:1]) * (SHIFT_PRIOR / SHIFT_STEP), r[:1]])
        felt = [k for k, change in enumerate(changes) if FELT_BY_DRIVES & set(change.effect.equations)]
        columns = columns[[*felt, len(changes), len(changes) + 1]]
        for j in range(r.shape[2]):  # a drive knows nothing of the others
            index = np.array([*(start[k] + j for k in felt), shift0 + j, gram.shape[1] - 1])
            add_products(gram, columns[:, :, j], index, self.part.block)

    def add_local(self, gram: Array, at: Point, directions: Array, last: int) -> None:
        """Add the inner products of the columns of `local_part` to gram (blocks, c, c); most are zero."""
        near = self._near(at, directions)
        for j in range(near.moves.shape[1]):  # a drive knows nothing of the others
            mine = np.flatnonzero(near.moves[:, j])
            columns = np.stack([*(near.of_direction[i][:, j] for i in mine), near.of_shift[:, j], near.residual[:, j]])
            add_products(gram, columns, np.array([*mine, len(directions) + j, last]), self.part.block)

    def local_part(self, at: Point, directions: Array, last: int) -> LocalPart:
        """Columns (c, T, J, 3) of directions (k, n) and of the shifts; last: place of the residual."""
        near, k = self._near(at, directions), len(directions)
        joints = near.moves.shape[1]
        columns = np.zeros((k + joints + 1, *near.residual.shape))
        for column, moved, here in zip(columns[:k], near.of_direction, near.moves, strict=True):
            column[:, here] = moved[:, here]
        for j, column in enumerate(columns[k:-1]):
            column[:, j] = near.of_shift[:, j]
        columns[-1] = near.residual
        return LocalPart(columns, np.r_[0 : k + joints, last], self.part.block)

    def _near(self, at: Point, directions: Array) -> "_Near":
        """The replays that local products of directions (k, n) need."""
        moves = np.array([self.atoms.joints_moved(d, FELT_BY_DRIVES) for d in directions], bool)
        moves = moves.reshape(len(directions), len(self.atoms.joint_names))
        groups = apart(moves)
        merged = [at._replace(x=at.x + directions[group].sum(0)) for group in groups]
        r = self.residual([at, *merged, at._replace(shift=at.shift + SHIFT_STEP)])
        of_group = r[1:-1] - r[:1]
        member = {i: g for g, group in enumerate(groups) for i in group}
        of_direction = [of_group[member[i]] for i in range(len(directions))]
        return _Near(moves, of_direction, (r[-1] - r[0]) * (SHIFT_PRIOR / SHIFT_STEP), r[0])


class _Near(NamedTuple):
    """Replays near a point: what each direction changes at the joints that it moves, and what the shifts do."""

    moves: Array  # (k, J) bool
    of_direction: list[Array]  # k times (T, J, 3); at other joints it is what another direction changes
    of_shift: Array  # (T, J, 3)
    residual: Array  # (T, J, 3)


def apart(joints: Array) -> list[list[int]]:
    """Groups of directions that move no joint twice, by the joints (k, J) that each moves.

    A drive knows nothing of the others (but through a sagging supply): one replay serves a whole group.
    """
    groups: list[list[int]] = []
    taken: list[Array] = []
    for i, mine in enumerate(joints):
        g = next((g for g, others in enumerate(taken) if not (others & mine).any()), len(groups))
        if g == len(groups):
            groups.append([])
            taken.append(np.zeros_like(mine))
        groups[g].append(i)
        taken[g] = taken[g] | mine
    return groups
