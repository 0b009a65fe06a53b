"""All that one log says about the plant: the parts that it measures, in one currency, residual over noise."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.blocks import BLOCK, add_products, sum_blocks
from experiments.measurement.evidence.body_evidence import FELT_BY_BODIES, BodyEvidence
from experiments.measurement.evidence.body_replay import DECIMATION, filter_window
from experiments.measurement.evidence.drive_evidence import FELT_BY_DRIVES, DriveEvidence
from experiments.measurement.evidence.drive_ripple import ripple_lines
from experiments.measurement.evidence.features import Change, Products, Seeds
from experiments.measurement.evidence.load_evidence import LoadEvidence
from experiments.measurement.evidence.remembered import Remembered

SHIFT_STEP = 1e-4  # rad
SHIFT_PRIOR = 3e-4  # rad, standard deviation of what the first motor angle may be wrong by


class Point(NamedTuple):
    """Numbers at which the replay runs: atoms (n,), shift of the first motor angle (J,), channel offsets (C,)."""

    x: np.ndarray
    shift: np.ndarray
    offset: np.ndarray


class LocalPart(NamedTuple):
    """Columns near a point of one part of a log: what directions and the log's nuisances change, then the residual.

    columns (c, rows, …); index (c,): their places in a gram matrix; block (rows,).
    """

    columns: np.ndarray
    index: np.ndarray
    block: np.ndarray


@dataclass(frozen=True, eq=False)
class Evidence:
    """The parts of one log; `blocks` is their number of BLOCKs."""

    name: str
    atoms: Atoms
    drive: DriveEvidence | None
    body: BodyEvidence | LoadEvidence | None
    blocks: int
    period: float
    model_x: np.ndarray  # (n,)
    drives_known: Remembered = field(default_factory=Remembered)
    bodies_known: Remembered = field(default_factory=Remembered)

    @property
    def offsets(self) -> int:
        """Channels C of the bodies."""
        return 0 if self.body is None else len(self.body.channels)

    @property
    def not_judged(self) -> str:
        """What the log does not show, in one sentence; empty where it shows all."""
        if self.body is None:
            return (
                f"Only the drives of {self.name} are judged: for bodies and contact log joint_torque and, on the "
                "ground, base_position and base_orientation."
            )
        if self.drive is None:
            return f"Only the bodies of {self.name} are judged: for the drives log their commands and motor_position."
        return ""

    @property
    def standing(self) -> bool:
        """Whether the log shows the robot on the ground."""
        return isinstance(self.body, BodyEvidence) and not self.body.replay.clamped

    def start(self) -> Point:
        """Where every fit begins: the model's own effects, nothing else off."""
        return Point(self.model_x, np.zeros(len(self.atoms.joint_names)), np.zeros(self.offsets))

    def seeds_at(self, point: Point) -> Seeds:
        """Starts of shape parameters that what is left at a point brings."""
        if self.drive is None or "torque_ripple" not in {effect.name for effect in self.atoms.effects}:
            return {}
        lines = ripple_lines(self.drive, self.drive_residual([point])[0])
        return {"torque_ripple": tuple({"harmonic": harmonic} for harmonic in lines)}

    def drive_residual(self, points: list[Point]) -> np.ndarray:
        """(H, T, J, 3) in units of the floor. Points that differ only in what the drives do not feel are run once."""
        xs, shifts = np.stack([p.x for p in points]), np.stack([p.shift for p in points])
        felt = np.concatenate([xs[:, self.atoms.touching(FELT_BY_DRIVES)], shifts], 1)
        return self.drives_known.ask(felt, lambda new: self.drive.residual(xs[new], shifts[new]))

    def body_residual(self, points: list[Point]) -> np.ndarray:
        """(H, N, C) in units of the floor."""
        xs, offsets = np.stack([p.x for p in points]), np.stack([p.offset for p in points])
        felt = xs[:, self.atoms.touching(FELT_BY_BODIES)]
        found = self.bodies_known.ask(felt, lambda new: self.body.residual(xs[new]))
        return found - offsets[:, None] * self.body.used[None]

    def block_of_drive(self) -> np.ndarray:
        return np.minimum((np.arange(self.drive.rows) * self.period / BLOCK).astype(int), self.blocks - 1)

    def time_of_body(self) -> np.ndarray:
        """Time of each residual of the bodies (N,), s from the log's start."""
        first = filter_window(self.period) // 2
        return (first + DECIMATION * np.arange(len(self.body.used))) * self.period

    def block_of_body(self) -> np.ndarray:
        return np.minimum((self.time_of_body() / BLOCK).astype(int), self.blocks - 1)

    def chi2(self, points: list[Point]) -> np.ndarray:
        """Sum of squared residuals, body rows thinned to independent ones: (H, blocks)."""
        total = np.zeros((len(points), self.blocks))
        if self.drive is not None:
            r = self.drive_residual(points)
            total += sum_blocks((r**2).sum((2, 3)), self.block_of_drive(), self.blocks)
        if self.body is not None:
            r = self.body_residual(points) / np.sqrt(self.body.tau)
            total += sum_blocks((r**2).sum(2), self.block_of_body(), self.blocks)
        return total

    def constant_errors(self, at: Point) -> np.ndarray:
        """What the channels' constant errors add to chi^2 beside the residuals, (blocks, C): how unlikely they are for
        the model, over the rows that a channel counts on."""
        if self.body is None:
            return np.zeros((self.blocks, 0))
        count = sum_blocks(self.body.used.T, self.block_of_body(), self.blocks).T
        return (at.offset / self.offset_scale()) ** 2 * count / np.maximum(count.sum(0), 1.0)

    def weight(self) -> np.ndarray:
        """Expected chi^2 of noise alone per block (blocks,)."""
        total = np.zeros(self.blocks)
        if self.drive is not None:
            total += sum_blocks(self.drive.used.sum((1, 2))[None], self.block_of_drive(), self.blocks)[0]
        if self.body is not None:
            total += sum_blocks((self.body.used / self.body.tau).sum(1)[None], self.block_of_body(), self.blocks)[0]
        return total

    def products(self, at: Point, changes: list[Change]) -> Products:
        """Inner products of the features of `changes`, of this log's own nuisances and of the residual at a point."""
        sizes = [self.atoms.of(c.effect.name)[0].size for c in changes]
        start = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        joints, channels = len(self.atoms.joint_names), self.offsets
        shift0, offset0 = start[-1], start[-1] + joints
        width = offset0 + channels + 1
        gram = np.zeros((self.blocks, width, width))
        if self.drive is not None:
            self._drive_products(gram, at, changes, start, shift0)
        if self.body is not None:
            self._body_products(gram, at, changes, start, sizes, offset0)
        prior = np.zeros(width)
        prior[shift0:offset0] = 1.0  # the shift column is scaled to its standard deviation
        prior[offset0 : offset0 + channels] = 1.0
        return Products(gram, tuple(start[:-1]), tuple(range(shift0, offset0 + channels)), prior)

    def local(self, at: Point, directions: np.ndarray) -> np.ndarray:
        """Gram matrices (blocks, c, c) of a few directions (k, n) at a point: directions, shifts, offsets, residual."""
        width = len(directions) + len(self.coefficients(at)) + 1
        gram = np.zeros((self.blocks, width, width))
        for part in self.local_parts(at, directions):
            add_products(gram, part.columns, part.index, part.block)
        return gram

    def local_parts(self, at: Point, directions: np.ndarray) -> list[LocalPart]:
        """The same before products are taken: the columns of the drives, (c, T, J, 3), and the bodies', (c, N, C)."""
        k, joints, last = len(directions), len(self.atoms.joint_names), len(directions) + len(self.coefficients(at))
        parts = []
        if self.drive is not None:
            here = [self.atoms.joints_moved(d, FELT_BY_DRIVES) for d in directions]
            groups = apart(here)
            merged = [at._replace(x=at.x + directions[group].sum(0)) for group in groups]
            r = self.drive_residual([at, *merged, at._replace(shift=at.shift + SHIFT_STEP)])
            of_group = {i: r[1 + g] - r[0] for g, group in enumerate(groups) for i in group}
            moved = [of_group[i] * here[i][None, :, None] for i in range(k)]
            shift = (r[-1] - r[0]) * (SHIFT_PRIOR / SHIFT_STEP)
            own = np.eye(joints)[:, None, :, None] * shift[None]
            columns = np.concatenate([*(m[None] for m in moved), own, r[:1]])
            parts.append(LocalPart(columns, np.r_[0 : k + joints, last], self.block_of_drive()))
        if self.body is not None:
            moved = [at, *(at._replace(x=at.x + d) for d in directions)]
            r = self.body_residual(moved) / np.sqrt(self.body.tau)
            columns = np.concatenate([r[1:] - r[:1], self._offset_columns(), r[:1]])
            parts.append(LocalPart(columns, np.r_[0:k, k + joints : last + 1], self.block_of_body()))
        return parts

    def nuisances(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of a gram's nuisance columns as changes of shifts (J,) and offsets (C,)."""
        joints = len(self.atoms.joint_names)
        return z[:joints] * SHIFT_PRIOR, z[joints:] * (self.offset_scale() if self.body is not None else 0.0)

    def coefficients(self, at: Point) -> np.ndarray:
        """Where a point's shifts and offsets stand, in units of their priors: the inverse of `nuisances`."""
        scale = self.offset_scale() if self.body is not None else np.ones(len(at.offset))
        return np.concatenate([at.shift / SHIFT_PRIOR, at.offset / scale])

    def _offset_columns(self) -> np.ndarray:
        """What a constant error of each body channel, of the size of the model's own error, does: (C, N, C)."""
        scale = self.offset_scale() / np.sqrt(self.body.tau)
        return np.einsum("nc,cd->cnd", self.body.used, np.diag(-scale))

    def offset_scale(self) -> np.ndarray:
        """Standard deviation of a channel's constant error, in units of its floor."""
        return self.body.model_error / self.body.floor

    def _drive_products(self, gram, at: Point, changes, start, shift0) -> None:
        at = at._replace(shift=np.zeros_like(at.shift))  # where the priors of the nuisances have their centre
        points = [at, at._replace(shift=at.shift + SHIFT_STEP)]
        points += [at._replace(x=changed(self.atoms, at.x, change)) for change in changes]
        r = self.drive_residual(points)
        joints = r.shape[2]
        # a change too large for the replay says nothing
        moved = np.nan_to_num(r[2:] - r[:1], nan=0.0, posinf=0.0, neginf=0.0)
        columns = np.concatenate([moved, (r[1:2] - r[:1]) * (SHIFT_PRIOR / SHIFT_STEP), r[:1]])
        block = self.block_of_drive()
        for j in range(joints):
            here = [s + j if self._on_drives(c) else -1 for s, c in zip(start, changes)] + [
                shift0 + j,
                gram.shape[1] - 1,
            ]
            kept = [i for i, place in enumerate(here) if place >= 0]
            index = np.array([here[i] for i in kept])
            part = columns[kept][:, :, j]
            for b in range(self.blocks):
                m = part[:, block == b].reshape(len(kept), -1).astype(float)
                gram[b][np.ix_(index, index)] += m @ m.T

    def _body_products(self, gram, at: Point, changes, start, sizes, offset0) -> None:
        at = at._replace(offset=np.zeros_like(at.offset))
        points, index = [at], []
        for change, first, size in zip(changes, start, sizes):
            if not FELT_BY_BODIES & set(change.effect.equations):
                continue
            for i in range(size):
                points.append(at._replace(x=changed(self.atoms, at.x, change, i)))
                index.append(first + i)
        r = self.body_residual(points) / np.sqrt(self.body.tau)
        columns = np.concatenate([r[1:] - r[:1], self._offset_columns(), r[:1]])
        index = np.array([*index, *range(offset0, gram.shape[1])])
        add_products(gram, columns, index, self.block_of_body())

    def _on_drives(self, change: Change) -> bool:
        return bool(FELT_BY_DRIVES & set(change.effect.equations))


def changed(atoms: Atoms, x: np.ndarray, change: Change, place: int | None = None) -> np.ndarray:
    """x with a change added: strengths move by it, shapes are set, at every place of its axis or at one."""
    x = x.copy()
    values = change.values()
    for column in atoms.of(change.effect.name):
        if column.parameter.name in values:
            here = slice(column.start, column.start + column.size)
            here = here if place is None else column.start + place
            moved = x[here] + values[column.parameter.name]
            x[here] = moved if column.parameter.name == change.strength else values[column.parameter.name]
    return x


def apart(joints: list[np.ndarray]) -> list[list[int]]:
    """Groups of directions that move no joint twice, by the joints (J,) that each moves.

    A drive knows nothing of the others (but through a sagging supply): one replay serves a whole group.
    """
    groups: list[list[int]] = []
    taken: list[np.ndarray] = []
    for i, mine in enumerate(joints):
        g = next((g for g, others in enumerate(taken) if not (others & mine).any()), len(groups))
        if g == len(groups):
            groups.append([])
            taken.append(np.zeros_like(mine))
        groups[g].append(i)
        taken[g] = taken[g] | mine
    return groups
