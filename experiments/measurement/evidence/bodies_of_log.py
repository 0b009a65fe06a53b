"""The bodies of one log as a fit asks for them: residuals and what numbers change in them, with a memory of replays."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.blocks import BLOCK, add_products, sum_blocks
from experiments.measurement.evidence.body_evidence import FELT_BY_BODIES, FEWEST, BodyEvidence
from experiments.measurement.evidence.body_replay import DECIMATION, filter_window
from experiments.measurement.evidence.features import Change, changed
from experiments.measurement.evidence.load_evidence import LoadEvidence
from experiments.measurement.evidence.log_evidence import LocalPart, Point
from experiments.measurement.evidence.parts import Part, Rest
from experiments.measurement.evidence.remembered import Remembered
from experiments.measurement.evidence.row_motion import Inputs, RowMotion

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class BodiesOfLog:
    """N smoothed rows of C channels."""

    body: BodyEvidence | LoadEvidence
    atoms: Atoms
    blocks: int
    period: float  # of the log's rows, s
    known: Remembered = field(default_factory=Remembered)

    @cached_property
    def part(self) -> Part:
        names, channels = self.atoms.joint_names, np.array(self.body.channels)
        places = [channel.partition("/")[2] for channel in self.body.channels]
        joint = np.array([names.index(place) if place in names else -1 for place in places])
        block = np.minimum((self.time() / BLOCK).astype(int), self.blocks - 1)
        used, tau = self.body.used, self.body.tau
        return Part("body", channels, joint, used, block, FELT_BY_BODIES, tau, FEWEST, coupled=True)

    def time(self) -> Array:
        """Of each residual (N,), s from the log's start."""
        first = filter_window(self.period) // 2
        return (first + DECIMATION * np.arange(len(self.body.used))) * self.period

    def offset_scale(self) -> Array:
        """Standard deviation of a channel's constant error (C,), in units of its floor."""
        return self.body.model_error / self.body.floor

    def residual(self, points: list[Point]) -> Array:
        """(H, N, C) in units of the floor. Points that differ only in what the bodies do not feel are run once."""
        xs, offsets = np.stack([p.x for p in points]), np.stack([p.offset for p in points])
        felt = xs[:, self.atoms.touching(FELT_BY_BODIES)]
        found = self.known.ask(felt, lambda new: self.body.residual(xs[new]))
        return found - offsets[:, None] * self.body.used[None]

    def constant_errors(self, at: Point) -> Array:
        """What constant errors add to chi^2 beside the residuals, (blocks, C): how unlikely they are for the model,
        over the rows that a channel counts on."""
        count = sum_blocks(self.body.used.T, self.part.block, self.blocks).T
        return (at.offset / self.offset_scale()) ** 2 * count / np.maximum(count.sum(0), 1.0)

    def rest(self, point: Point) -> Rest:
        return Rest(self.part, self.residual([point])[0], self.constant_errors(point))

    def motion(self, point: Point) -> RowMotion:
        """Of the links' joints, as measured."""
        return self.body.motion(self._rows())

    def inputs(self, point: Point) -> Inputs:
        return Inputs(self.motion(point).inputs(), self.body.torso_inputs(self._rows()))

    def add_products(self, gram: Array, at: Point, changes: list[Change], start: Array, offset0: int) -> None:
        """Add the inner products of features, offsets and residual to gram (blocks, c, c).

        start (changes,), offset0: first columns of each feature, and of the offsets.
        """
        at = at._replace(offset=np.zeros_like(at.offset))
        points, index = [], []
        for change, first in zip(changes, start, strict=True):
            if not FELT_BY_BODIES & set(change.effect.equations):
                continue
            for i in range(self.atoms.of(change.effect.name)[0].size):
                points.append(at._replace(x=changed(self.atoms, at.x, change, i)))
                index.append(first + i)
        columns = self._columns([at, *points])
        add_products(gram, columns, np.array([*index, *range(offset0, gram.shape[1])]), self.part.block)

    def local_part(self, at: Point, directions: Array, first: int, last: int) -> LocalPart:
        """Columns (c, N, C) of directions (k, n) and of the offsets; first, last: places of these and the residual."""
        columns = self._columns([at, *(at._replace(x=at.x + d) for d in directions)])
        return LocalPart(columns, np.r_[0 : len(directions), first : last + 1], self.part.block)

    def _columns(self, points: list[Point]) -> Array:
        """What the points after the first change, what the offsets do, and the first one's residual: (c, N, C)."""
        r = self.residual(points) / np.sqrt(self.body.tau)
        return np.concatenate([r[1:] - r[:1], self._offset_columns(), r[:1]])

    def _offset_columns(self) -> Array:
        """What a constant error of each channel, of the size of the model's own error, does: (C, N, C)."""
        scale = self.offset_scale() / np.sqrt(self.body.tau)
        return np.einsum("nc,cd->cnd", self.body.used, np.diag(-scale))

    def _rows(self) -> Array:
        """Rows of the log (N,) beside the residuals."""
        return np.minimum(np.round(self.time() / self.period).astype(int), len(self.body.log.torque) - 1)
