"""The drives replayed on what was measured: logged commands, logged (noisy) feedback, and the measured link motion.

What is left between replay and log of motor position, joint torque and motor current belongs to the drive: the
bodies' part of the plant does not enter (DIAGNOSIS, step 1).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from experiments.effects.compose import ActiveEffects, EffectNumbers
from experiments.measurement.evidence.drive_log import DriveLog
from sea_jax import DriveParams, JointCommand, JointMeasurement, JointMotion, LoopPeriods
from sea_jax.hooks import link_signals
from sea_jax.link_motion import link_motion, smoothed_link_motion
from sea_jax.replay import ReplayRows, Timing, measured_start, replay

Array = jax.Array

CHANNELS = ("motor_position", "joint_torque", "motor_current")


@dataclass(frozen=True)
class DriveReplay:
    """Replay of J drives with effects: what is static about it."""

    periods: LoopPeriods
    effects: ActiveEffects

    def predict(
        self, params: DriveParams, log: DriveLog, motion: JointMotion, numbers: EffectNumbers, shift: Array
    ) -> Array:
        """Predicted CHANNELS (T, J, 3) on the log's rows.

        params: nominal; motion: see `true_motion`; shift (J,) rad: what the first row's motor angle is wrong by.
        """
        active, joints = self.effects, log.joint_position.shape[1]
        params = active.apply("drive_parameters", numbers, params)
        hooks = active.drive_hooks(numbers)
        # once a row, outside of the loop, on what was logged
        memory = {hook: one for hook, one in active.memory(joints).items() if hook not in ("command", "measurement")}
        motion = jax.vmap(lambda row: active.apply("measured_motion", numbers, row))(motion)
        signals = jax.vmap(lambda row: link_signals(row, self.periods.control))(motion)

        command = JointCommand(log.command_torque, log.command_position, log.position_mode)
        command = _along_rows(hooks.command, command, signals, active.memory_at("command", joints))
        seen = JointMeasurement(log.joint_position, log.joint_velocity, log.joint_torque, log.motor_position)
        start = measured_start(
            params, log.motor_position[0] + shift, log.motor_velocity[0], log.motor_current[0], memory
        )
        still = jnp.zeros_like(start.motor_position)
        timing = active.apply("replay_timing", numbers, Timing(*(still,) * 4))
        timing = active.apply("loop_timing", numbers, timing)
        rows = ReplayRows(command, seen, motion)
        run = replay(params, hooks._replace(command=()), rows, start, self.periods, timing=timing)
        shown = JointMeasurement(motion.position, motion.velocity, run.joint_torque, run.motor_position)
        prompt, values = active.without("replay_timing", numbers)
        past = prompt.memory_at("measurement", joints)
        shown = _along_rows(prompt.hooks("measurement", values), shown, signals, past)
        return jnp.stack([shown.motor_position, shown.torque, run.motor_current], -1)


def true_motion(log: DriveLog, period: float, noise: dict[str, float]) -> JointMotion:
    """The links' motion (T, J) behind noisy encoders; smoothed where the noise is known."""
    if "joint_position" in noise and "joint_velocity" in noise:
        return smoothed_link_motion(
            jnp.asarray(log.joint_position),
            jnp.asarray(log.joint_velocity),
            period,
            noise["joint_position"],
            noise["joint_velocity"],
        )
    return link_motion(jnp.asarray(log.joint_position), jnp.asarray(log.joint_velocity), period)


def measured(log: DriveLog) -> np.ndarray:
    """What the replay predicts, as it was measured: CHANNELS (T, J, 3)."""
    return np.stack([log.motor_position, log.joint_torque, log.motor_current], -1)


def _along_rows(hooks, rows, signals, memory):
    """Apply once-a-row hooks, in order, along a log and its rows of signals."""
    for hook, start in zip(hooks, memory, strict=True):
        if start.shape[1] == 0:
            rows = jax.vmap(lambda row, s, hook=hook, start=start: hook(row, s, start)[0])(rows, signals)
            continue

        def step(state, inputs, hook=hook):
            row, state = hook(*inputs, state)
            return state, row

        _, rows = jax.lax.scan(step, start, (rows, signals))
    return rows
