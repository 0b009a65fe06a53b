"""The closed loop tick by tick on another engine: MuJoCo C at small steps, or mjx.step, in place of Moreau's step."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.plant import PlantOutput, PlantState
from experiments.rollout import Rollout, Score, Tick
from experiments.trial import NOISE_COLUMNS, nominal_trial
from mjx_starleth.bodies import BodyInput
from mjx_starleth.mjx_engine import make_mjx_engine
from mjx_starleth.mujoco_c import MujocoC
from sea_jax import JointCommand, JointMotion

Array = jax.Array


def run_with_engine(engine: str, rollout: Rollout, values: Array) -> tuple[Score, Tick]:
    """One nominal trial on an engine: what Rollout.record gives, with that engine's bodies."""
    plant, task = rollout.plant, rollout.task
    params = plant.prepare(plant.params)
    trial = nominal_trial()
    state, controller = task.start(plant, params, task.settings, values, trial)
    move = ENGINES[engine](rollout, params)
    sense = jax.jit(lambda s, c, e, t: _sense(rollout, params, values, s, c, e, t))
    observe = jax.jit(task.observe)
    estimator, tally = rollout.sensing.start(state), task.first_tally()
    ticks = []
    for k in range(task.ticks):
        time = jnp.float32(k * plant.periods.control)
        sensed, controller, estimator, measurement, robot, targets, info = sense(state, controller, estimator, time)
        after, output = move(sensed, targets, measurement)
        tick = Tick(time, state, after, robot, measurement, targets, info, output, jnp.float32(1.0))
        tally = observe(tally, tick)
        ticks.append(jax.tree.map(np.asarray, tick))
        state = after
    score = task.score(values, tally, jnp.float32(0.0), state)
    return score, jax.tree.map(lambda *rows: np.stack(rows), *ticks)


def _sense(rollout: Rollout, params: Any, values: Array, state: PlantState, controller: Any, estimator: Any, time):
    sensed, measurement = rollout.plant.measure(params, state)
    silent = jnp.zeros(NOISE_COLUMNS, jnp.float32)
    estimator, robot, measurement = rollout.sensing.step(estimator, sensed, measurement, silent)
    controller, targets, info = rollout.task.control(rollout.task.settings, values, controller, robot, time)
    return sensed, controller, estimator, measurement, robot, targets, info


def _mujoco_c(rollout: Rollout, params: Any):
    """MuJoCo C; it gets the drives' mean torque of a period, with their answer to the links' change of speed."""
    plant = rollout.plant
    bodies = MujocoC(plant.numbers, params.bodies, plant.periods.control)
    drive = jax.jit(lambda state, targets, measurement: _drive(plant, params, state, targets, measurement))

    def move(state: PlantState, targets, measurement) -> tuple[PlantState, PlantOutput]:
        after_drive, output = drive(state, targets, measurement)
        moved, body = bodies.step(state.bodies, BodyInput(output.torque, output.damping))
        after = PlantState(moved, after_drive, output.end_torque, body.contact_force, state.sensor_memory)
        return jax.tree.map(jnp.asarray, (after, PlantOutput(output, body)))

    return move


def _drive(plant, params, state: PlantState, targets, measurement):
    motion = JointMotion(
        state.bodies.q[7:],
        state.bodies.u[6:],
        jnp.zeros(12),
        jnp.repeat(jnp.sqrt((state.contact_force**2).sum(-1) + 1e-6), 3),
    )
    command = JointCommand(targets.torque, targets.position, targets.position_mode)
    hooks = plant.effects.drive_hooks(params.effects)
    return plant.drive_step(params.drive, state.drive, (command, measurement, motion), hooks, plant.periods)


def _mjx(rollout: Rollout, params: Any):
    """mjx.step with MuJoCo's soft contact, its joint damping takes the drive's."""
    plant = rollout.plant
    engine = make_mjx_engine(plant.numbers, params.bodies, plant.periods.control)

    @jax.jit
    def move(state: PlantState, targets, measurement) -> tuple[PlantState, PlantOutput]:
        after_drive, output = _drive(plant, params, state, targets, measurement)
        bodies, body = engine.step(params.bodies, state.bodies, BodyInput(output.torque, output.damping))
        after = PlantState(bodies, after_drive, output.end_torque, body.contact_force, state.sensor_memory)
        return after, PlantOutput(output, body)

    return move


ENGINES: Mapping[str, Any] = MappingProxyType({"moreau": None, "mujoco_c": _mujoco_c, "mjx": _mjx})
