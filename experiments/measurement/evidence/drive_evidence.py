"""What a log says about the drives: replays with many sets of numbers at once, and the noise that replays leave."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import jax
import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from experiments.lanes import lanes
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.drive_log import DriveLog
from experiments.measurement.evidence.drive_replay import CHANNELS, DriveReplay, measured, true_motion
from experiments.measurement.evidence.padding import padded
from experiments.measurement.evidence.turns import next_devices
from sea_jax import DriveParams, JointMotion, LoopPeriods

LANES = 8  # sets of numbers per call of the one compiled replay: another might round otherwise
PAD = 800  # rows, of which logs are made a multiple
SETTLE = 0.05  # s at the start of a log, in which the loops forget what was before it
FLOOR_DRAWS = 3  # re-noised link motions from which the replay's own noise is estimated
STUCK = 0.01  # rad/s of the gear below which dry friction may hold the motor
STUCK_NOISE = 4.0  # standard deviations of that speed, where the encoder is too rough to tell so slow a motion
STUCK_REACH = 5  # rows to both sides over which that speed is taken
STUCK_LONG = 0.05  # s from which a motor counts as held, not as turning round
DRIFT = 0.2  # s: in torque mode slower errors of the motor angle are not judged
FORGOTTEN = 0.1  # s after which the loops have forgotten a held motor's current, an impact, an angle left open
IMPACT = 800.0  # rad/s^2 of a link above which its motion within a row is not known

FELT_BY_DRIVES = frozenset(
    "drive_parameters command measurement measured_motion replay_timing loop_timing "
    "commanded_velocity supply_voltage motor_torque friction deflection spring".split()
)


@dataclass(frozen=True, eq=False)
class DriveEvidence:
    """One log's drives. floor (J, 3): what noise alone leaves per channel; used (rows, J, 3): 1.0 where it counts."""

    atoms: Atoms
    replay: DriveReplay
    params: DriveParams  # nominal
    log: DriveLog  # padded
    motion: JointMotion  # padded
    rows: int
    period: float
    measured: np.ndarray  # (rows, J, 3)
    used: np.ndarray  # (rows, J, 3)
    floor: np.ndarray  # (J, 3)
    renoised: tuple[JointMotion, ...]  # padded: what the links' motion would be with their sensors' noise once more

    def predict(self, xs: np.ndarray, shifts: np.ndarray) -> np.ndarray:
        """Predictions (H, rows, J, 3) for atom vectors (H, n) and shifts of the first motor angle (H, J)."""
        return self.play(self.log, self.motion, xs, shifts)[:, : self.rows]

    def play(self, log: DriveLog, motion: JointMotion, xs: np.ndarray, shifts: np.ndarray) -> np.ndarray:
        """The same for other commands and another motion, (H, T, J, 3)."""
        return predict(self.replay, self.params, self.atoms, log, motion, xs, shifts)

    def residual(self, xs: np.ndarray, shifts: np.ndarray) -> np.ndarray:
        """Replay minus measurement in units of the floor, (H, rows, J, 3); zero where a row does not count."""
        r = (self.predict(xs, shifts) - self.measured[None]) / self.floor[None, None] * self.used[None]
        r[..., CHANNELS.index("motor_position")] -= self._drift(r[..., CHANNELS.index("motor_position")])
        return r

    def _drift(self, error: np.ndarray) -> np.ndarray:
        """Slow part of the motor angle's error (H, rows, J) in torque mode.

        Nothing holds the angle there but the velocity loop: it sums up what the loop's steps do to a noisy speed, and
        the current tells all that an effect could.
        """
        by_torque = (1.0 - self.log.position_mode[: self.rows]) * self.used[..., CHANNELS.index("motor_position")]
        size = 2 * round(0.5 * DRIFT / self.period) + 1
        count = uniform_filter1d(by_torque, size, axis=0, mode="constant")
        mean = uniform_filter1d(error * by_torque, size, axis=1, mode="constant") / np.maximum(count, 1e-6)
        return mean * by_torque


def drive_evidence(
    atoms: Atoms, params: DriveParams, periods: LoopPeriods, log: DriveLog, period: float, noise: Mapping[str, float]
) -> DriveEvidence:
    """Prepare a log's drives. `atoms` may hold effects that do not touch the drives; they change nothing here."""
    rows = len(log.joint_position)
    longer = padded(log, PAD)
    replay = DriveReplay(periods, atoms.active())
    motion = true_motion(longer, period, noise)
    sensors = np.array([noise[channel] for channel in CHANNELS])
    clean = _nominal(replay, params, atoms, longer, motion)
    used = rows_that_count(log, period, noise["motor_position"])
    renoised, spread = _renoised(longer, period, noise), np.zeros(clean.shape[1:])
    for motion_again in renoised:
        again = _nominal(replay, params, atoms, longer, motion_again)
        spread += ((again - clean)[:rows] ** 2 * used).sum(0) / np.maximum(used.sum(0), 1.0) / FLOOR_DRAWS
    floor = np.sqrt(sensors**2 + spread)
    return DriveEvidence(atoms, replay, params, longer, motion, rows, period, measured(log), used, floor, renoised)


def rows_that_count(log: DriveLog, period: float, noise: float) -> np.ndarray:
    """1.0 for the rows that count (T, J, 3); noise: standard deviation of the motor position, rad.

    Not while the loops settle; not when a row cannot tell the link's motion, nor when position mode takes over the
    angle that torque mode left open; and no current of a motor that friction holds.
    """
    used = np.ones((*log.motor_position.shape, len(CHANNELS)), np.float32)
    used[: round(SETTLE / period)] = 0.0
    hit = np.abs(np.diff(log.joint_velocity, axis=0, append=log.joint_velocity[-1:])) > IMPACT * period
    entered = np.diff(log.position_mode, axis=0, prepend=log.position_mode[:1]) > 0.5
    used *= ~_with_later(hit | entered, period)[..., None]
    used[..., CHANNELS.index("motor_current")] *= ~_with_later(_held(log, period, noise), period)
    return used


def _held(log: DriveLog, period: float, noise: float) -> np.ndarray:
    """Rows (T, J) of a motor at rest for long.

    Friction takes any value up to its level there, and the current with it: which one, the noise of long ago decides.
    """
    index = np.arange(len(log.motor_position))
    before, after = np.maximum(index - STUCK_REACH, 0), np.minimum(index + STUCK_REACH, index[-1])
    moved = log.motor_position[after] - log.motor_position[before]
    span = (period * (after - before))[:, None]
    slow = np.abs(moved) < np.maximum(STUCK * span, STUCK_NOISE * np.sqrt(2.0) * noise)
    long = 2 * round(0.5 * STUCK_LONG / period) + 1
    return maximum_filter1d(minimum_filter1d(slow, long, axis=0), long, axis=0)


def _with_later(rows: np.ndarray, period: float) -> np.ndarray:
    """These rows (T, J) and those after them until the loops have forgotten."""
    reach = 2 * round(0.5 * FORGOTTEN / period)
    return maximum_filter1d(rows, reach + 1, axis=0, origin=reach // 2)


def predict(
    replay: DriveReplay,
    params: DriveParams,
    atoms: Atoms,
    log: DriveLog,
    motion: JointMotion,
    xs: np.ndarray,
    shifts: np.ndarray,
) -> np.ndarray:
    """Predictions (H, T, J, 3) through the compiled programs, on all devices in turn."""
    starts = range(0, len(xs), LANES)
    devices = next_devices(len(starts))
    places = [(device, *jax.device_put((params, log, motion), device)) for device in devices]
    parts = []
    for start, (device, *measured_there) in zip(starts, itertools.cycle(places), strict=False):
        here = np.minimum(np.arange(start, start + LANES), len(xs) - 1)
        numbers = jax.device_put((xs[here].astype(np.float32), shifts[here].astype(np.float32)), device)
        parts.append(_lanes(replay, atoms, *measured_there, *numbers))
    return np.concatenate([np.asarray(part) for part in parts])[: len(xs)]


@partial(jax.jit, static_argnums=(0, 1))
def _lanes(replay, atoms, params, log, motion, xs, shifts):
    def one(shared, numbers):
        x, shift = numbers
        return replay.predict(*shared, atoms.numbers(x), shift)

    return lanes(one)((params, log, motion), (xs, shifts))


def _nominal(replay: DriveReplay, params: DriveParams, atoms: Atoms, log: DriveLog, motion: JointMotion) -> np.ndarray:
    off = atoms.off()[None]
    return predict(replay, params, atoms, log, motion, off, np.zeros((1, log.joint_position.shape[1])))[0]


def _renoised(log: DriveLog, period: float, noise: Mapping[str, float]) -> tuple[JointMotion, ...]:
    rng = np.random.default_rng(0)
    draws = []
    for _ in range(FLOOR_DRAWS):
        position = _noisy(rng, log.joint_position, noise["joint_position"])
        velocity = _noisy(rng, log.joint_velocity, noise["joint_velocity"])
        draws.append(true_motion(log._replace(joint_position=position, joint_velocity=velocity), period, noise))
    return tuple(draws)


def _noisy(rng: np.random.Generator, table: np.ndarray, std: float) -> np.ndarray:
    return (table + std * rng.standard_normal(table.shape)).astype(np.float32)
