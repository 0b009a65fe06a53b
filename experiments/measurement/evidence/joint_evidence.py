"""What a bench log of one rigid joint says: the same questions as of the robot's logs, with one channel, the effort."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import jax
import numpy as np

from experiments.effects.bench import Scale, bench_effects, sized
from experiments.effects.effect import Effect
from experiments.errors import UserError
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.blocks import BLOCK, add_products, sum_blocks
from experiments.measurement.evidence.features import Change, Products, Seeds
from experiments.measurement.evidence.joint_replay import (
    STILL,
    JointLog,
    JointReplay,
    corner,
    low_pass,
    moving,
    raw_rows,
    rigid_drive,
)
from experiments.measurement.evidence.joint_ripple import with_ripple_seeds
from experiments.measurement.evidence.log_evidence import LocalPart, Point, changed
from experiments.measurement.evidence.remembered import Remembered
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.noise_floor import estimated
from experiments.model import JointNumbers, Model

LANES = 16  # sets of numbers per call of the compiled replay
PAD = 2000  # rows: logs are padded to a multiple, so that logs of like length share one compiled program
MODEL_ERROR = 0.01  # of the RMS effort: what the best model of a real machine leaves; below it nothing is missing
FLOOR_DRAWS = 4
REACH = 3.0  # periods of the corner from a log's end, within which filters do not know what was before


@dataclass(frozen=True)
class Filter:
    """The zero-phase filter that everything passes, and the rows that are independent after it."""

    frequency: float  # Hz, corner
    period: float  # s

    @property
    def stride(self) -> int:
        """Rows of the log per judged row: two to a period of the corner."""
        return max(1, round(0.5 / (self.frequency * self.period)))

    def log(self, position: np.ndarray, effort: np.ndarray) -> JointLog:
        return moving(position, effort, self.frequency, self.period)

    def inner(self, rows: int) -> np.ndarray:
        """1.0 for the judged rows (N,) of a log of so many rows that the filter's ends do not reach."""
        count = -(-rows // self.stride)
        ends = round(REACH / (self.frequency * self.period * self.stride))
        found = np.zeros(count)
        found[ends : count - ends] = 1.0
        return found

    def thinned(self, rows: np.ndarray) -> np.ndarray:
        """(H, T) filtered, every stride-th row of it: (H, N)."""
        return low_pass(np.asarray(rows, float), self.frequency, self.period)[:, :: self.stride]


@dataclass(frozen=True, eq=False)
class JointEvidence:
    """One bench log. floor: what noise and a good model leave of the effort; used (N,): rows in motion."""

    name: str
    atoms: Atoms
    replay: JointReplay
    log: JointLog
    filter: Filter
    rows: int
    period: float
    still: float  # speed below which the joint may stand
    model_x: np.ndarray
    used: np.ndarray
    floor: float
    blocks: int
    known: Remembered = field(default_factory=Remembered)
    drive: None = field(default=None)
    body: None = field(default=None)
    standing: bool = field(default=False)
    not_judged: str = field(default="")

    def start(self) -> Point:
        """Where every fit begins: the model's own effects."""
        return Point(self.model_x, np.zeros(1), np.zeros(0))

    def seeds_at(self, point: Point) -> Seeds:
        """None beyond those of its effects, which know its lines."""
        return {}

    def predict(self, points: list[Point]) -> np.ndarray:
        """Unfiltered residual effort (H, T) in its unit."""
        xs = np.stack([p.x for p in points])
        return self.known.ask(xs, lambda new: _residuals(self.replay, self.atoms, self.log, self.still, xs[new]))[
            :, : self.rows
        ]

    def residual(self, points: list[Point]) -> np.ndarray:
        """(H, N) in units of the floor, zero where the joint may stand."""
        return self.filter.thinned(self.predict(points)) / self.floor * self.used

    def measured(self) -> np.ndarray:
        """Effort (N,) on the rows that are judged."""
        return self.filter.thinned(self.log.effort[None])[0]

    def fit_percent(self, point: Point, rows: np.ndarray | None = None) -> float:
        """100 (1 - |effort - model| / |effort|) over all rows, or those of a mask (N,)."""
        error, effort = self.filter.thinned(self.predict([point]))[0], self.measured()
        chosen = self.filter.inner(self.rows) > 0
        chosen = chosen if rows is None else chosen & rows
        return float(100.0 * (1.0 - np.linalg.norm(error[chosen]) / np.linalg.norm(effort[chosen])))

    def block_of_rows(self) -> np.ndarray:
        """Block of each judged row."""
        time = np.arange(len(self.used)) * self.filter.stride * self.period
        return np.minimum((time / BLOCK).astype(int), self.blocks - 1)

    def chi2(self, points: list[Point]) -> np.ndarray:
        """Sum of squared residuals on the judged rows: (H, blocks)."""
        return sum_blocks(self.residual(points) ** 2, self.block_of_rows(), self.blocks)

    def constant_errors(self, at: Point) -> np.ndarray:
        """A bench log has no channels of bodies: (blocks, 0)."""
        return np.zeros((self.blocks, 0))

    def weight(self) -> np.ndarray:
        """Expected chi^2 of noise alone per block (blocks,)."""
        return sum_blocks(self.used[None], self.block_of_rows(), self.blocks)[0]

    def products(self, at: Point, changes: list[Change]) -> Products:
        """Inner products of the features of `changes` and of the residual at a point."""
        moved = [at, *(at._replace(x=changed(self.atoms, at.x, c)) for c in changes)]
        return Products(self._gram(self._part(moved)), tuple(range(len(changes))), (), np.zeros(len(changes) + 1))

    def local(self, at: Point, directions: np.ndarray) -> np.ndarray:
        """Gram matrices (blocks, k + 1, k + 1) of a few directions (k, n) at a point, the residual last."""
        return self._gram(self.local_parts(at, directions)[0])

    def local_parts(self, at: Point, directions: np.ndarray) -> list[LocalPart]:
        """The columns of those products, (k + 1, N)."""
        return [self._part([at, *(at._replace(x=at.x + d) for d in directions)])]

    def _part(self, moved: list[Point]) -> LocalPart:
        r = self.residual(moved)
        return LocalPart(np.concatenate([r[1:] - r[:1], r[:1]]), np.arange(len(moved)), self.block_of_rows())

    def _gram(self, part: LocalPart) -> np.ndarray:
        gram = np.zeros((self.blocks, len(part.columns), len(part.columns)))
        add_products(gram, *part)
        return gram

    def nuisances(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A bench log has none of its own."""
        return np.zeros(1), np.zeros(0)

    def coefficients(self, at: Point) -> np.ndarray:
        return np.zeros(0)


def joint_evidence(log: Log, model: Model, library: Mapping[str, Effect], noise: Mapping[str, float]) -> JointEvidence:
    """Prepare a bench log. Raises UserError where it cannot be judged."""
    joint = model.joint
    if joint is None:
        raise UserError(f"{log.name} is a log of a single joint, but the model is the robot's; give the joint's model.")
    if log.rows * log.sample_period < 4 * BLOCK:
        raise UserError(f"{log.name} is shorter than {4 * BLOCK:g} s; record a longer motion.")
    position, effort = raw_rows(log)
    if np.ptp(position) <= 0:
        raise UserError(f"{log.name}: the joint never moves; record a motion.")
    period = log.sample_period
    noise = _own_noise(log, noise)
    filter_ = Filter(corner(joint.inertia, _rms(effort), noise["joint_position"], period), period)
    own = filter_.log(position, effort)
    speed = np.abs(own.velocity)
    still = STILL * float(speed.max())
    effects = _effects(log, model, library, own, filter_, still)
    atoms = Atoms(tuple(effects.values()), log.joint_names)
    replay = JointReplay(rigid_drive(joint), joint.gravity_load, atoms.active(), period)
    used = (filter_.thinned((speed > still).astype(float)[None])[0] > 0.99) * filter_.inner(log.rows)
    floor = _floor(filter_, replay, atoms, still, position, effort, used, noise)
    return JointEvidence(
        name=log.name,
        atoms=atoms,
        replay=replay,
        log=own,
        filter=filter_,
        rows=log.rows,
        period=period,
        still=still,
        model_x=atoms.placed(atoms.off(), model.effects),
        used=used,
        floor=floor,
        blocks=max(int(log.rows * period / BLOCK), 1),
    )


def _own_noise(log: Log, stated: Mapping[str, float]) -> dict[str, float]:
    """Noise of both signals: what the rows show where that is less than is stated (many drives filter their logs)."""
    found = {}
    for name in ("joint_position", "applied_torque"):
        shown = estimated(log.signals[name].values)
        found[name] = min(shown, stated.get(name, np.inf)) if shown > 0 else stated.get(name, 0.0)
    return found


def _effects(log: Log, model: Model, library, own: JointLog, filter_: Filter, still: float) -> dict[str, Effect]:
    """What may act on this joint, with sizes that its log suggests."""
    joint: JointNumbers = model.joint
    effects = bench_effects(library, joint.kind == "prismatic")
    foreign = [e.effect for e in model.effects if e.effect not in effects]
    if foreign:
        raise UserError(f"The model has the effect {foreign[0]}, which a rigid joint cannot show; remove it.")
    scale = Scale(_rms(own.effort), float(np.ptp(own.position)), float(np.abs(own.velocity).max()))
    effects = sized(effects, library, scale, joint.viscous_friction)
    bare = Atoms((), log.joint_names)
    nominal = JointReplay(rigid_drive(joint), joint.gravity_load, bare.active(), filter_.period)
    left = _residuals(nominal, bare, own, still, np.zeros((1, 0)))[0]
    return with_ripple_seeds(effects, own, left, scale.travel, filter_.stride)


def _floor(filter_: Filter, replay, atoms, still: float, position, effort, used, noise: Mapping[str, float]) -> float:
    """RMS of what the sensors' noise and the model of a good machine leave, in the effort's unit."""
    rng, off = np.random.default_rng(0), atoms.off()[None]
    clean = filter_.thinned(_residuals(replay, atoms, filter_.log(position, effort), still, off))
    total = 0.0
    for _ in range(FLOOR_DRAWS):
        noisy = filter_.log(
            position + noise["joint_position"] * rng.standard_normal(len(position)),
            effort + noise["applied_torque"] * rng.standard_normal(len(effort)),
        )
        error = filter_.thinned(_residuals(replay, atoms, noisy, still, off)) - clean
        total += (error**2 * used).sum() / max(used.sum(), 1.0) / FLOOR_DRAWS
    return float(np.hypot(np.sqrt(total), MODEL_ERROR * _rms(effort)))


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt((np.asarray(x, float) ** 2).mean()))


def _residuals(replay: JointReplay, atoms: Atoms, log: JointLog, still: float, xs: np.ndarray) -> np.ndarray:
    """(H, T), LANES at a time through one compiled program."""
    rows = len(log.effort)
    padded = JointLog(*(np.concatenate([x, np.repeat(x[-1:], -rows % PAD)]) for x in log))
    found = []
    for i in range(0, len(xs), LANES):
        part = xs[i : i + LANES]
        full = np.concatenate([part, np.repeat(part[-1:], LANES - len(part), 0)]).astype(np.float32)
        found.append(np.asarray(_lanes(replay, atoms, padded, np.float32(still), full))[: len(part), :rows])
    return np.concatenate(found)


@partial(jax.jit, static_argnums=(0, 1))
def _lanes(replay: JointReplay, atoms: Atoms, log: JointLog, still, xs):
    return jax.vmap(lambda x: replay.residual(log, still, atoms.numbers(x)))(xs)
