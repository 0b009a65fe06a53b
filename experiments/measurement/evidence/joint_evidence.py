"""What a bench log of one rigid joint says: one part with one channel, the effort, and no nuisances of its own."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from experiments.effects.bench import FELT_BY_RIGID_JOINT
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.blocks import BLOCK, add_products
from experiments.measurement.evidence.effort_filter import Filter
from experiments.measurement.evidence.features import Change, Products, Seeds, changed
from experiments.measurement.evidence.joint_lanes import residuals
from experiments.measurement.evidence.joint_replay import JointLog, JointReplay
from experiments.measurement.evidence.log_evidence import LocalPart, Point
from experiments.measurement.evidence.parts import Part, Rest
from experiments.measurement.evidence.remembered import Remembered
from experiments.measurement.evidence.row_motion import Inputs, MeasuredMotion, RowMotion, row_motion

Array = np.ndarray

FAST = 0.5  # of the joint's largest speed


@dataclass(frozen=True, eq=False)
class JointEvidence:
    """One bench log, an `Evidence`. floor: what noise and a good model leave of the effort; used (N,): rows in
    motion."""

    name: str
    atoms: Atoms
    replay: JointReplay
    log: JointLog
    filter: Filter
    rows: int
    period: float
    still: float  # speed below which the joint may stand
    model_x: Array
    used: Array
    floor: float
    blocks: int
    known: Remembered = field(default_factory=Remembered)

    rigid = True
    drive = body = None
    standing = False
    not_judged = ""

    @cached_property
    def part(self) -> Part:
        """Its channel has the shape (1, 1): one signal of one joint."""
        time = np.arange(len(self.used)) * self.filter.stride * self.period
        block = np.minimum((time / BLOCK).astype(int), self.blocks - 1)
        channels, joint, used = np.array([["effort"]]), np.zeros((1, 1), int), self.used[:, None, None]
        return Part("effort", channels, joint, used, block, FELT_BY_RIGID_JOINT)

    @property
    def parts(self) -> tuple[Part, ...]:
        return (self.part,)

    def rests(self, point: Point) -> tuple[Rest, ...]:
        residual = self.residual([point])[0][:, None, None]
        return (Rest(self.part, residual, np.zeros((self.blocks, 1, 1))),)

    def motions(self, point: Point) -> tuple[RowMotion, ...]:
        row = slice(0, self.rows, self.filter.stride)
        return (row_motion(*(x[row, None] for x in (self.log.position, self.log.velocity, self.log.effort))),)

    def inputs(self, point: Point) -> tuple[Inputs, ...]:
        return tuple(Inputs(motion.inputs()) for motion in self.motions(point))

    def measured_motion(self) -> MeasuredMotion:
        velocity = self.filter.thinned(self.log.velocity[None]).T
        no_modes, period = np.full_like(velocity, np.nan), self.period * self.filter.stride
        return MeasuredMotion(velocity, self.measured()[:, None], no_modes, period, FAST * np.abs(velocity).max())

    def start(self) -> Point:
        """Where every fit begins: the model's own effects."""
        return Point(self.model_x, np.zeros(1), np.zeros(0))

    def seeds_at(self, point: Point) -> Seeds:
        """None beyond those of its effects, which know its lines."""
        return {}

    def predict(self, points: list[Point]) -> Array:
        """Unfiltered residual effort (H, T) in its unit."""
        xs = np.stack([p.x for p in points])
        found = self.known.ask(xs, lambda new: residuals(self.replay, self.atoms, self.log, self.still, xs[new]))
        return found[:, : self.rows]

    def residual(self, points: list[Point]) -> Array:
        """(H, N) in units of the floor, zero where the joint may stand."""
        return self.filter.thinned(self.predict(points)) / self.floor * self.used

    def measured(self) -> Array:
        """Effort (N,) on the rows that are judged."""
        return self.filter.thinned(self.log.effort[None])[0]

    def fit_percent(self, point: Point, rows: Array | None = None) -> float:
        """100 (1 - |effort - model| / |effort|) over all rows, or those of a mask (N,)."""
        error, effort = self.filter.thinned(self.predict([point]))[0], self.measured()
        chosen = self.filter.inner(self.rows) > 0
        chosen = chosen if rows is None else chosen & rows
        return float(100.0 * (1.0 - np.linalg.norm(error[chosen]) / np.linalg.norm(effort[chosen])))

    def chi2(self, points: list[Point]) -> Array:
        """Sum of squared residuals on the judged rows: (H, blocks)."""
        return self.part.chi2(self.residual(points), self.blocks)

    def weight(self) -> Array:
        """Expected chi^2 of noise alone per block (blocks,)."""
        return self.part.weight(self.blocks)

    def constant_errors(self, at: Point) -> Array:
        """A bench log has no channels of bodies: (blocks, 0)."""
        return np.zeros((self.blocks, 0))

    def products(self, at: Point, changes: list[Change]) -> Products:
        """Inner products of the features of `changes` and of the residual at a point."""
        moved = [at, *(at._replace(x=changed(self.atoms, at.x, c)) for c in changes)]
        return Products(self._gram(self._local(moved)), tuple(range(len(changes))), (), np.zeros(len(changes) + 1))

    def local(self, at: Point, directions: Array) -> Array:
        """Gram matrices (blocks, k + 1, k + 1) of a few directions (k, n) at a point, the residual last."""
        return self._gram(self.local_parts(at, directions)[0])

    def local_parts(self, at: Point, directions: Array) -> list[LocalPart]:
        """The columns of those products, (k + 1, N, 1, 1)."""
        return [self._local([at, *(at._replace(x=at.x + d) for d in directions)])]

    def nuisances(self, z: Array) -> tuple[Array, Array]:
        """A bench log has none of its own."""
        return np.zeros(1), np.zeros(0)

    def coefficients(self, at: Point) -> Array:
        return np.zeros(0)

    def _local(self, moved: list[Point]) -> LocalPart:
        r = self.residual(moved)[..., None, None]
        return LocalPart(np.concatenate([r[1:] - r[:1], r[:1]]), np.arange(len(moved)), self.part.block)

    def _gram(self, part: LocalPart) -> Array:
        gram = np.zeros((self.blocks, len(part.columns), len(part.columns)))
        add_products(gram, *part)
        return gram
