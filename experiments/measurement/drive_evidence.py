"""What a log says about the drives: replays with many sets of numbers at once, and the noise that replays leave."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from experiments.measurement.atoms import Atoms
from experiments.measurement.drive_log import DriveLog
from experiments.measurement.drive_replay import CHANNELS, DriveReplay, measured, true_motion
from sea_jax import DriveParams, JointMotion, LoopPeriods

LANES = (8, 2)  # sets of numbers per call: one compiled replay for each, so that few sets do not cost as many
PAD = 800  # rows: logs are padded to a multiple, so that logs of like length share one compiled program
SETTLE = 0.05  # s at the start of a log, in which the loops forget what was before it
FLOOR_DRAWS = 3  # re-noised link motions from which the replay's own noise is estimated

DRIVE_HOOKS = frozenset(
    "drive_parameters command measurement measured_motion commanded_velocity supply_voltage motor_torque friction deflection spring".split()
)


@dataclass(frozen=True, eq=False)
class DriveEvidence:
    """One log's drives. noise: of the sensors by signal name; floor (J, 3): what noise alone leaves per channel."""

    atoms: Atoms
    replay: DriveReplay
    log: DriveLog  # padded
    motion: JointMotion  # padded
    rows: int
    period: float
    measured: np.ndarray  # (rows, J, 3)
    floor: np.ndarray  # (J, 3)

    def predict(self, xs: np.ndarray, shifts: np.ndarray) -> np.ndarray:
        """Predictions (H, rows, J, 3) for atom vectors (H, n) and shifts of the first motor angle (H, J)."""
        return predict(self.replay, self.atoms, self.log, self.motion, xs, shifts)[:, : self.rows]

    def residual(self, xs: np.ndarray, shifts: np.ndarray) -> np.ndarray:
        """Replay minus measurement in units of the floor, (H, rows, J, 3); zero while the loops settle."""
        r = (self.predict(xs, shifts) - self.measured[None]) / self.floor[None, None]
        r[:, : round(SETTLE / self.period)] = 0.0
        return r


def drive_evidence(
    atoms: Atoms, params: DriveParams, periods: LoopPeriods, log: DriveLog, period: float, noise: Mapping[str, float]
) -> DriveEvidence:
    """Prepare a log's drives. `atoms` may hold effects that do not touch the drives; they change nothing here."""
    rows = len(log.joint_position)
    padded = DriveLog(*(_pad(table) for table in log))
    replay = DriveReplay(params, periods, atoms.active())
    motion = true_motion(padded, period, noise)
    sensors = np.array([noise[channel] for channel in CHANNELS])
    clean = _nominal(replay, atoms, padded, motion)
    rng, spread = np.random.default_rng(0), np.zeros(clean.shape[1:])
    for _ in range(FLOOR_DRAWS):
        noisy = padded._replace(
            joint_position=_noisy(rng, padded.joint_position, noise["joint_position"]),
            joint_velocity=_noisy(rng, padded.joint_velocity, noise["joint_velocity"]),
        )
        again = _nominal(replay, atoms, padded, true_motion(noisy, period, noise))
        spread += ((again - clean)[:rows] ** 2).mean(0) / FLOOR_DRAWS
    floor = np.sqrt(sensors**2 + spread)
    return DriveEvidence(atoms, replay, padded, motion, rows, period, measured(log), floor)


def predict(
    replay: DriveReplay, atoms: Atoms, log: DriveLog, motion: JointMotion, xs: np.ndarray, shifts: np.ndarray
) -> np.ndarray:
    """Predictions (H, T, J, 3) through the compiled programs, on all devices in turn."""
    places = [(device, *jax.device_put((log, motion), device)) for device in jax.local_devices()]
    parts, done = [], 0
    while done < len(xs):
        left = len(xs) - done
        lanes = next((n for n in LANES if n <= left), LANES[-1])
        here = np.minimum(np.arange(done, done + lanes), len(xs) - 1)
        device, its_log, its_motion = places[len(parts) % len(places)]
        numbers = jax.device_put((xs[here].astype(np.float32), shifts[here].astype(np.float32)), device)
        parts.append(_lanes(replay, atoms, its_log, its_motion, *numbers)[: min(lanes, left)])
        done += lanes
    return np.concatenate([np.asarray(part) for part in parts])


@partial(jax.jit, static_argnums=(0, 1))
def _lanes(replay, atoms, log, motion, xs, shifts):
    return jax.vmap(lambda x, shift: replay.predict(log, motion, atoms.numbers(x), shift))(xs, shifts)


def _nominal(replay: DriveReplay, atoms: Atoms, log: DriveLog, motion: JointMotion) -> np.ndarray:
    off = atoms.off()[None]
    return predict(replay, atoms, log, motion, off, np.zeros((1, log.joint_position.shape[1])))[0]


def _pad(table: np.ndarray) -> np.ndarray:
    missing = -len(table) % PAD
    return np.concatenate([table, np.repeat(table[-1:], missing, axis=0)])


def _noisy(rng: np.random.Generator, table: np.ndarray, std: float) -> np.ndarray:
    return (table + std * rng.standard_normal(table.shape)).astype(np.float32)


__all__ = ["DRIVE_HOOKS", "DriveEvidence", "drive_evidence", "jnp"]
