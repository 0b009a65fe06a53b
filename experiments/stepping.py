"""The closed loop tick by tick on another engine: MuJoCo C at small steps, or mjx.step, in place of Moreau's step."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.plant import PlantInput, PlantOutput, PlantParams, PlantState, joined
from experiments.rollout import Rollout, Score, Tick
from experiments.trial import Trial
from mjx_starleth.mjx_engine import make_mjx_engine
from mjx_starleth.mujoco_c import MujocoC

Array = jax.Array
Move = Callable[[PlantState, PlantInput], tuple[PlantState, PlantOutput]]


def run_with_engine(
    engine: str, rollout: Rollout, params: PlantParams, settings: Any, values: Array, trial: Trial
) -> tuple[Score, Tick]:
    """One trial on an engine: what Rollout.record gives, with that engine's bodies (NumPy leaves).

    Raises ValueError for a ground that the engine does not know.
    """
    params, carry = rollout.begin(params, settings, values, trial)
    move = ENGINES[engine](rollout, params)
    decide = jax.jit(lambda carry, k: rollout.decide(params, settings, values, trial, carry, k))
    conclude = jax.jit(rollout.conclude)
    ticks = []
    for k in range(rollout.task.ticks):
        decision = decide(carry, jnp.int32(k))
        carry, tick = conclude(carry, decision, move(decision.sensed, decision.inputs))
        ticks.append(jax.tree.map(np.asarray, tick))
    last, _, _, tally, alive = carry
    score = rollout.task.score(values, tally, 1.0 - alive, last)
    return jax.tree.map(np.asarray, score), jax.tree.map(lambda *rows: np.stack(rows), *ticks)


def _mujoco_c(rollout: Rollout, params: PlantParams) -> Move:
    """MuJoCo C; it gets the drives' mean torque of a period, with their answer to the links' change of speed."""
    plant = rollout.plant
    bodies = MujocoC(plant.numbers, params.bodies, plant.periods.control)
    drives = jax.jit(lambda state, inputs: plant.drives_step(params, state, inputs))

    def move(state: PlantState, inputs: PlantInput) -> tuple[PlantState, PlantOutput]:
        drive, acting = drives(state, inputs)
        return joined(state, drive, bodies.step(state.bodies, acting))

    return move


def _mjx(rollout: Rollout, params: PlantParams) -> Move:
    """mjx.step with MuJoCo's soft contact, its joint damping takes the drive's."""
    plant = rollout.plant
    engine = make_mjx_engine(plant.numbers, params.bodies, plant.periods.control)

    @jax.jit
    def move(state: PlantState, inputs: PlantInput) -> tuple[PlantState, PlantOutput]:
        drive, acting = plant.drives_step(params, state, inputs)
        return joined(state, drive, engine.step(params.bodies, state.bodies, acting))

    return move


ENGINES: Mapping[str, Any] = MappingProxyType({"moreau": None, "mujoco_c": _mujoco_c, "mjx": _mjx})
