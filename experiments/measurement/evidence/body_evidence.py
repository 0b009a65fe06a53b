"""What a log says about bodies, contact and joint sensors: inverse-dynamics residuals and the noise they carry."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.body_replay import (
    BodyLog,
    BodyReplay,
    BodyResidual,
    body_log,
    body_replay,
    thinned,
)
from experiments.measurement.evidence.body_rows import around, hits, rows_sliding, rows_used
from experiments.measurement.evidence.calm_log import calm_log
from experiments.measurement.evidence.padding import padded
from experiments.measurement.evidence.row_motion import RowMotion, row_motion
from experiments.measurement.evidence.turns import next_devices
from experiments.measurement.logs.log import Log
from mjx_starleth.names import JOINT_NAMES, LEGS
from mjx_starleth.numbers import RobotNumbers

FELT_BY_BODIES = frozenset("body_parameters measurement measured_motion replay_timing joint_drag torso_force".split())
FLOOR_DRAWS = 3
FEWEST = 20  # rows of a channel that tell its size
PAD = 800  # rows, of which logs are made a multiple

# What the best model of a real robot may still leave in each channel: below this nothing is called missing.
MODEL_ERROR = {"force": 0.5, "torque": 0.05, "joint": 0.06, "gap": 5e-4, "friction": 0.04}
NO_CONSTANT = 1e-6  # of a channel whose constant error tells of an effect
CHANNELS = (
    *(f"torso_force/{axis}" for axis in "xyz"),
    *(f"torso_torque/{axis}" for axis in "xyz"),
    *(f"link_torque/{name}" for name in JOINT_NAMES),
    *(f"foot_height/{leg}" for leg in LEGS),
    *(f"friction/{leg}" for leg in LEGS),
)
SMOOTHED = len(CHANNELS) - len(LEGS)  # of the channels; friction is taken row by row
KIND = ["force"] * 3 + ["torque"] * 3 + ["joint"] * 12 + ["gap"] * 4 + ["friction"] * 4


@dataclass(frozen=True, eq=False)
class BodyEvidence:
    """One log's bodies. floor (26,): what noise alone leaves in CHANNELS; used (N, 26): rows that count."""

    atoms: Atoms
    replay: BodyReplay
    log: BodyLog  # without most of its noise: the changes that numbers make are taken from it
    measured: np.ndarray  # (N, 26) what the nominal model leaves, physical units
    nominal: np.ndarray  # (N, 26) the same of that log
    sliding: np.ndarray  # (T, 4) rows on which a foot slides
    period: float
    used: np.ndarray  # (N, 26) 1.0 where a row counts
    floor: np.ndarray  # (26,) physical units
    tau: np.ndarray  # (26,) rows of residual that carry as much as one independent row

    @property
    def channels(self) -> tuple[str, ...]:
        return CHANNELS

    @property
    def model_error(self) -> np.ndarray:
        """What the best model of a real robot may be wrong by all the time in each channel (26,)."""
        return np.array([NO_CONSTANT if kind == "friction" else MODEL_ERROR[kind] for kind in KIND])

    def motion(self, rows: np.ndarray) -> RowMotion:
        """Of the legs' joints, as measured on these rows (N,) of the log."""
        return row_motion(self.log.q[rows, 7:], self.log.u[rows, 6:], self.log.torque[rows])

    def torso_inputs(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """What a rest at the torso or the feet may go with, in words, on these rows of the log: (N,) each."""
        q, u, push = (x[rows].astype(float) for x in (self.log.q, self.log.u, self.log.du))
        return {
            **{f"torso's velocity along {axis}": u[:, i] for i, axis in enumerate("xyz")},
            **{f"torso's turning rate about {axis}": u[:, 3 + i] for i, axis in enumerate("xyz")},
            **{f"torso's tilt about {axis}": 2.0 * q[:, 4 + i] for i, axis in enumerate("xy")},
            **{f"torso's acceleration along {axis}": push[:, i] for i, axis in enumerate("xyz")},
            "torso's height": q[:, 2],
            "time": np.arange(len(rows), dtype=float),
        }

    def predict(self, xs: np.ndarray) -> np.ndarray:
        """Residuals (H, N, 26) in physical units for atom vectors (H, n).

        What numbers change is taken from a log with little noise (calm_log tells why).
        """
        found = residuals(self.replay, self.atoms, self.log, self.sliding, self.period, xs)
        return self.measured + found - self.nominal

    def residual(self, xs: np.ndarray) -> np.ndarray:
        """Residuals (H, N, 26) in units of the floor, zero where a row does not count."""
        return self.predict(xs) / self.floor[None, None] * self.used[None]


def body_evidence(atoms: Atoms, numbers: RobotNumbers, log: Log, noise: Mapping[str, float]) -> BodyEvidence:
    """Prepare a log's bodies; noise: standard deviations of the sensors by signal name."""
    rows, period = body_log(log), log.sample_period
    clamped = log.experiment == "fixed_base"
    replay = body_replay(numbers, atoms.active(), clamped)
    off = atoms.off()[None]
    raw = residual_rows(replay, atoms, rows, off)[0]
    rng = np.random.default_rng(0)
    draws = [_noisy(rng, rows, noise, period, clamped) for _ in range(FLOOR_DRAWS)]
    noisy = [residual_rows(replay, atoms, one, off)[0] for one in draws]
    stops = np.asarray(replay.bodies.params.joint_stop)
    sliding = rows_sliding(rows, raw, noisy[0] - raw) & ~hits(rows, period, stops)
    used = rows_used(rows, sliding, period, clamped, stops)
    clean = _kept(raw, sliding, period)
    error = np.stack([_kept(one, sliding, period) - clean for one in noisy])
    calm = _unless(sliding.any(1), rows, calm_log(rows, period, noise))  # a slide may be over in a few rows
    nominal = residuals(replay, atoms, calm, sliding, period, off)[0]
    tau = correlation_rows(error * used[None])
    floor = _floor(clean, error, used)
    return BodyEvidence(atoms, replay, calm, clean, nominal, sliding, period, used, floor, tau)


def _floor(clean: np.ndarray, error: np.ndarray, used: np.ndarray) -> np.ndarray:
    """What noise alone leaves in each channel (26,), from what it left in draws (D, N, 26)."""
    count = np.maximum(used.sum(0), 1)
    spread = np.sqrt((error**2 * used[None]).sum((0, 1)) / count / len(error))
    # where the rows alias what is faster than their rate, the residual is rougher than noise makes it
    rough = _roughness(clean, used) / np.maximum(_roughness(error[0], used), 1e-12)
    floor = np.maximum(spread, 1e-9) * np.maximum(rough, 1.0)
    # a torque sampled at rows is not its mean between them: legs in the air show that first
    legs = np.array([kind == "joint" for kind in KIND])
    floor = np.where(legs, np.hypot(floor, MODEL_ERROR["joint"]), floor)
    # how slippery the ground is shows in a few rows of sliding, and all of it is a constant
    friction = np.array([kind == "friction" for kind in KIND])
    return np.where(friction, np.hypot(floor, MODEL_ERROR["friction"]), floor)


def residuals(
    replay: BodyReplay, atoms: Atoms, log: BodyLog, sliding: np.ndarray, period: float, xs: np.ndarray
) -> np.ndarray:
    """Smoothed and thinned residuals (H, N, 26) in physical units for atom vectors (H, n); sliding (T, 4): feet."""
    return np.stack([_kept(rows, sliding, period) for rows in residual_rows(replay, atoms, log, xs)])


def _kept(rows: np.ndarray, sliding: np.ndarray, period: float) -> np.ndarray:
    """Of residuals on raw rows (T, 34), what is judged (N, 26): smoothed, but friction where a foot slides."""
    smooth = thinned(rows[:, :SMOOTHED], period)
    beside = around(len(rows), period)
    use, slides = rows[beside][:, :, SMOOTHED : len(CHANNELS)], sliding[beside]
    friction = (use * slides).sum(1) / np.maximum(slides.sum(1), 1)
    return np.concatenate([smooth, friction], 1)


def residual_rows(replay: BodyReplay, atoms: Atoms, log: BodyLog, xs: np.ndarray) -> np.ndarray:
    """Residuals on raw rows, and the feet's normal force and sliding speed: (H, T, 26 + 4 + 4)."""
    rows, longer = len(log.q), padded(log, PAD)
    places = [(device, jax.device_put(longer, device)) for device in next_devices(len(xs))]
    turns = zip(xs.astype(np.float32), itertools.cycle(places))
    found = [_one(replay, atoms, its_log, jax.device_put(x, device)) for x, (device, its_log) in turns]
    return np.stack([np.asarray(one)[:rows] for one in found])


@partial(jax.jit, static_argnums=(0, 1))
def _one(replay: BodyReplay, atoms: Atoms, log: BodyLog, x):
    return _channels(replay.residual(log, atoms.numbers(x)))


def _channels(r: BodyResidual) -> jax.Array:
    normal = (r.foot_force * jnp.eye(3, dtype=jnp.float32)[2][None, None]).sum(-1)
    return jnp.concatenate([r.torso, r.joints, r.gap, r.friction, normal, r.slip_velocity], 1)


def _unless(here: np.ndarray, log: BodyLog, other: BodyLog) -> BodyLog:
    """The rows of a log that are `here` (T,), the other rows of another."""
    return BodyLog(*(np.where(here[:, None], own, its) for own, its in zip(log, other, strict=True)))


def _roughness(rows: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Size of the changes from row to row, per channel."""
    both = used[1:] * used[:-1]
    change = np.diff(rows, axis=0) ** 2 * both
    return np.sqrt(change.sum(0) / np.maximum(both.sum(0), 1))


def _noisy(rng: np.random.Generator, log: BodyLog, noise: Mapping[str, float], period: float, clamped: bool) -> BodyLog:
    """The log with its sensors' noise once more."""
    draw = lambda like, std: std * rng.standard_normal(like.shape)  # noqa: E731
    q, u = log.q.astype(float), log.u.astype(float)
    q[:, 7:] += draw(q[:, 7:], noise["joint_position"])
    u[:, 6:] += draw(u[:, 6:], noise["joint_velocity"])
    if not clamped:
        q[:, :3] += draw(q[:, :3], noise["base_position"])
        q[:, 3:7] += draw(q[:, 3:7], noise["base_orientation"])
        q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
        u[:, :3] += draw(u[:, :3], noise["base_linear_velocity"])
        u[:, 3:6] += draw(u[:, 3:6], noise["base_angular_velocity"])
    torque = log.torque + draw(log.torque, noise["joint_torque"])
    return BodyLog(*(np.asarray(a, np.float32) for a in (q, u, np.gradient(u, period, axis=0), torque, log.contact)))


def correlation_rows(error: np.ndarray, block: int = 40) -> np.ndarray:
    """Variance of block means over that of independent rows, at least 1: (channels,) from draws (D, N, channels).

    Fewer rows than a block's are one block.
    """
    block = min(block, error.shape[1])
    n = error.shape[1] // block * block
    means = error[:, :n].reshape(error.shape[0], -1, block, error.shape[2]).mean(2)
    single = (error**2).mean((0, 1))
    return np.maximum(1.0, block * (means**2).mean((0, 1)) / np.maximum(single, 1e-30))
