"""The drives replayed on what was measured: logged commands, logged (noisy) feedback, and the measured link motion.

What is left between replay and log of motor position, joint torque and motor current belongs to the drive: the
bodies' part of the plant does not enter (DIAGNOSIS, step 1).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from sea_jax import (
    DriveParams,
    JointCommand,
    JointMeasurement,
    JointMotion,
    LoopPeriods,
    full_drive,
    initial_state,
)
from sea_jax.hooks import no_signals

from experiments.effects.compose import ActiveEffects
from experiments.effects.effect import Effect, Parameter
from experiments.measurement.drive_log import DriveLog

Array = jax.Array

CHANNELS = ("motor_position", "joint_torque", "motor_current")


class EffectParameter(NamedTuple):
    """A row of the replay's table of numbers."""

    effect: Effect
    parameter: Parameter


@dataclass(frozen=True, eq=False)
class DriveReplay:
    """Replay of J drives with every effect of `effects` in the program, off where its numbers are.

    A table of numbers (M, J) has one row for each parameter of each effect, see `rows`.
    """

    params: DriveParams
    periods: LoopPeriods
    effects: tuple[Effect, ...]

    @property
    def rows(self) -> tuple[EffectParameter, ...]:
        return tuple(EffectParameter(e, p) for e in self.effects for p in e.parameters)

    def nothing(self, joints: int) -> np.ndarray:
        """The table (M, J) with every effect off."""
        return np.array([[row.parameter.off] * joints for row in self.rows], np.float32).reshape(-1, joints)

    def predict(self, log: DriveLog, table: Array) -> Array:
        """Predicted CHANNELS (T, J, 3) on the log's rows with the effects' numbers in `table` (M, J)."""
        active, numbers = ActiveEffects(self.effects), self._numbers(table)
        params = active.apply("drive_parameters", numbers, self.params)
        hooks = active.drive_hooks(numbers)
        # command and sensor hooks act once a row, on what was logged: outside of the drive's own loop
        commands = self._commands(log, hooks.command, active)
        hooks = hooks._replace(command=())
        motion = self._true_motion(log, active, numbers)
        memory = {
            k: v for k, v in active.memory(log.joint_position.shape[1]).items() if k not in ("command", "measurement")
        }
        # at rest before the log began, as far as its first row tells
        state = initial_state(params, motion.position[0], log.joint_torque[0], memory)
        state = state._replace(
            motor_position=log.motor_position[0],
            motor_velocity=log.motor_velocity[0],
            current=log.motor_current[0],
            velocity_integral=log.motor_current[0],
            current_integral=params.resistance * log.motor_current[0],
        )

        def row(state, inputs):
            command, measurement, link = inputs
            after, output = full_drive(params, state, (command, measurement, link), hooks, self.periods)
            return after, (output.end_torque, after.motor_position, after.current)

        measured = JointMeasurement(log.joint_position, log.joint_velocity, log.joint_torque, log.motor_position)
        _, (torque, position, current) = jax.lax.scan(row, state, (commands, measured, motion))
        first = (log.joint_torque[:1], log.motor_position[:1], log.motor_current[:1])
        torque, position, current = (
            jnp.concatenate([start, later[:-1]])
            for start, later in zip(first, (torque, position, current), strict=True)
        )
        shown = self._shown(JointMeasurement(motion.position, motion.velocity, torque, position), active, numbers)
        return jnp.stack([shown.motor_position, shown.torque, current], -1)

    def _numbers(self, table: Array) -> tuple[dict[str, Array], ...]:
        values = iter(table)
        return tuple({p.name: next(values) for p in effect.parameters} for effect in self.effects)

    def _commands(self, log: DriveLog, hooks, active: ActiveEffects) -> JointCommand:
        commands = JointCommand(log.command_torque, log.command_position, log.position_mode)
        if not hooks:
            return commands
        signals = no_signals(log.command_torque[0], self.periods.control)
        return _over_rows(hooks, commands, signals, active.memory(log.command_torque.shape[1]).get("command"))

    def _shown(self, true: JointMeasurement, active: ActiveEffects, numbers) -> JointMeasurement:
        hooks = active.hooks("measurement", numbers)
        if not hooks:
            return true
        signals = no_signals(true.torque[0], self.periods.control)
        return _over_rows(hooks, true, signals, active.memory(true.torque.shape[1]).get("measurement"))

    def _true_motion(self, log: DriveLog, active: ActiveEffects, numbers) -> JointMotion:
        q, v = log.joint_position, log.joint_velocity
        change = jnp.concatenate([v[1:] - v[:-1], jnp.zeros_like(v[:1])]) / self.periods.control
        motion = JointMotion(q, v, change, log.radial_load)
        shape = jax.vmap(lambda row: active.apply("measured_motion", numbers, row))
        return shape(motion)


def _over_rows(hooks, rows, signals, memory):
    """Apply once-a-row hooks, in order, along a log."""
    memory = memory or (None,) * len(hooks)
    for hook, start in zip(hooks, memory, strict=True):
        if start is None or start.shape[1] == 0:
            rows = jax.vmap(lambda row, hook=hook: hook(row, signals, start)[0])(rows)
            continue

        def step(state, row, hook=hook):
            row, state = hook(row, signals, state)
            return state, row

        _, rows = jax.lax.scan(step, start, rows)
    return rows


def measured(log: DriveLog) -> np.ndarray:
    """What the replay predicts, as it was measured: CHANNELS (T, J, 3)."""
    return np.stack([log.motor_position, log.joint_torque, log.motor_current], -1)


def effect_rows(replay: DriveReplay, effect: str) -> list[int]:
    """Rows of the table that belong to an effect."""
    return [i for i, row in enumerate(replay.rows) if row.effect.name == effect]


def fill(replay: DriveReplay, table: np.ndarray, effect: str, values: Mapping[str, float], joints: Sequence[int]):
    """A copy of the table with an effect's values set at some joints."""
    table = table.copy()
    for i in effect_rows(replay, effect):
        name = replay.rows[i].parameter.name
        if name in values:
            table[i, list(joints)] = values[name]
    return table
