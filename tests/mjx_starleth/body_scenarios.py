"""Shared by the tests of the bodies: compiled simulations (each compiled once) and a robot with locked joints."""

from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from mjx_starleth.bodies import Bodies, BodyInput, BodyParams, BodyState, make_bodies
from mjx_starleth.mjcf import mjcf
from mjx_starleth.numbers import load_numbers

NUMBERS = load_numbers()
MASS = 26.82  # kg, FACTS 1
GRAVITY = 9.81
# Damping that holds the joints as if welded: a torque of 10 N m creeps at 1e-4 rad/s.
LOCKED = np.full(12, 1e5, np.float32)


@cache
def bodies(period: float = 2.5e-3, dynamics: str = "legs") -> Bodies:
    return make_bodies(NUMBERS, period, dynamics=dynamics)


@cache
def _program(period: float, steps: int, dynamics: str):
    robot = bodies(period, dynamics)

    def run(params, state, inputs):
        def step(state, _):
            state, output = robot.step(params, state, inputs)
            return state, (state, output)

        return jax.lax.scan(step, state, None, length=steps)[1]

    return jax.jit(run)


def simulate(params: BodyParams, state: BodyState, inputs: BodyInput, steps=200, period=2.5e-3, dynamics="legs"):
    """States and outputs after each of `steps` periods under a constant input, as NumPy."""
    full = BodyInput(*(jnp.zeros(n) if x is None else jnp.asarray(x) for x, n in zip(inputs, (12, 12, 6, 18))))
    return jax.tree.map(np.asarray, _program(period, steps, dynamics)(params, state, full))


def mujoco_robot(**options) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The robot in MuJoCo C, without contacts unless asked for."""
    m = mujoco.MjModel.from_xml_string(mjcf(NUMBERS, **({"contact": False} | options)))
    return m, mujoco.MjData(m)


def random_state(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """q (19,) with any orientation and u (18,) of a vivid motion."""
    rng = np.random.default_rng(seed)
    turn = rng.normal(size=4)
    q = np.concatenate([rng.normal(size=3), turn / np.linalg.norm(turn), rng.uniform(-1.2, 1.2, 12)])
    return np.float32(q), np.float32(rng.normal(size=18) * 3)
