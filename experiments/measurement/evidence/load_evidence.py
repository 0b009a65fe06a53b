"""What a bench log says about the load behind a series-elastic drive: its equation of motion on what was measured.

    joint torque = J dv/dt + b v + G sin q + effects

evaluated on raw rows and smoothed afterwards, as the robot's bodies are.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import convolve1d

from experiments.effects.compose import EffectNumbers
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.behind_sensors import behind_sensors
from experiments.measurement.evidence.body_evidence import FLOOR_DRAWS, MODEL_ERROR, correlation_rows
from experiments.measurement.evidence.body_replay import thinned
from experiments.measurement.evidence.drive_log import DriveLog
from experiments.measurement.evidence.row_motion import RowMotion, row_motion
from experiments.model import JointNumbers
from sea_jax import JointMotion
from sea_jax.hooks import no_signals

Array = jax.Array


class LoadParams(NamedTuple):
    """The load's numbers, (1,) each."""

    inertia: Array  # kg m^2
    viscous_friction: Array  # N m s/rad
    gravity_load: Array  # N m at 90 degrees from hanging down


class LoadLog(NamedTuple):
    """Measurements on T rows, (T, 1) float32 each, SI."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray


@dataclass(frozen=True, eq=False)
class LoadEvidence:
    """One bench log's load; the same face to the fit as BodyEvidence, with one channel."""

    atoms: Atoms
    params: LoadParams
    log: LoadLog
    period: float
    used: np.ndarray  # (N, 1)
    floor: np.ndarray  # (1,)
    tau: np.ndarray  # (1,)

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(f"link_torque/{name}" for name in self.atoms.joint_names)

    @property
    def model_error(self) -> np.ndarray:
        """What the best model may leave (1,), N m."""
        return np.array([MODEL_ERROR["joint"]])

    def motion(self, rows: np.ndarray) -> RowMotion:
        """Of the joint, as measured on these rows (N,) of the log."""
        return row_motion(self.log.position[rows], self.log.velocity[rows], self.log.torque[rows])

    def torso_inputs(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """A joint on a bench has no torso."""
        return {}

    def residual(self, xs: np.ndarray) -> np.ndarray:
        """Residuals (H, N, 1) in units of the floor for atom vectors (H, n)."""
        rows = np.asarray(_rows(self.atoms, self.params, self.log, self.period, xs.astype(np.float32)))
        return np.stack([thinned(one, self.period) for one in rows]) / self.floor * self.used[None]


def load_evidence(
    atoms: Atoms, joint: JointNumbers, log: DriveLog, period: float, noise: Mapping[str, float]
) -> LoadEvidence:
    """Prepare a bench log's load; noise: standard deviations of the sensors by signal name."""
    numbers = (joint.inertia, joint.viscous_friction, joint.gravity_load)
    params = LoadParams(*(jnp.full(1, value, jnp.float32) for value in numbers))
    off, rng = atoms.off()[None].astype(np.float32), np.random.default_rng(0)

    def residual(table: DriveLog) -> np.ndarray:
        return thinned(np.asarray(_rows(atoms, params, _load_log(table, period), period, off))[0], period)

    def noisy(signal: str) -> np.ndarray:
        return getattr(log, signal) + noise[signal] * rng.standard_normal(log.joint_position.shape)

    clean = residual(log)
    signals = ("joint_position", "joint_velocity", "joint_torque")
    error = np.stack(
        [residual(log._replace(**{name: noisy(name) for name in signals})) - clean for _ in range(FLOOR_DRAWS)]
    )
    # a torque sampled at rows is not its mean between them
    floor = np.hypot(np.sqrt((error**2).mean((0, 1))), MODEL_ERROR["joint"])
    used = np.ones_like(clean)
    return LoadEvidence(atoms, params, _load_log(log, period), period, used, floor, correlation_rows(error))


def _load_log(log: DriveLog, period: float) -> LoadLog:
    # the central difference spans a row on both sides: so does the torque that caused it
    torque = convolve1d(log.joint_torque, [0.25, 0.5, 0.25], axis=0, mode="nearest")
    velocity = np.asarray(log.joint_velocity, float)
    tables = (log.joint_position, velocity, np.gradient(velocity, period, axis=0), torque)
    return LoadLog(*(np.asarray(table, np.float32) for table in tables))


@partial(jax.jit, static_argnums=0)
def _rows(atoms: Atoms, params: LoadParams, log: LoadLog, period: float, xs: Array) -> Array:
    return jax.vmap(lambda x: _residuals(atoms, params, log, period, atoms.numbers(x)))(xs)


def _residuals(atoms: Atoms, params: LoadParams, log: LoadLog, period: float, numbers: EffectNumbers) -> Array:
    """Torque (T, 1) that nothing accounts for."""
    motion = JointMotion(log.position, log.velocity, log.acceleration, jnp.zeros_like(log.torque))
    motion, torque = behind_sensors(atoms.active(), numbers, motion, log.torque, period)
    return jax.vmap(lambda *row: _residual(atoms, params, *row, numbers))(motion, torque)


def _residual(atoms: Atoms, params: LoadParams, motion: JointMotion, torque: Array, numbers: EffectNumbers) -> Array:
    """The same of a row, (1,)."""
    effects, zero = atoms.active(), jnp.zeros_like(torque)
    load = effects.apply("body_parameters", numbers, params)
    signals = no_signals(zero, 1.0)._replace(joint_position=motion.position, joint_velocity=motion.velocity)
    drag = effects.apply("joint_drag", numbers, zero, signals)
    own = load.viscous_friction * motion.velocity + load.gravity_load * jnp.sin(motion.position)
    return load.inertia * motion.acceleration + own + drag - torque
