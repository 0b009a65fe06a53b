"""Motions on which a drive is compared with the oracle, and the drive's run on them."""

import json
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import files

import jax
import jax.numpy as jnp
import numpy as np

from sea_jax import (
    DRIVES,
    DriveHooks,
    DriveParams,
    DriveState,
    JointCommand,
    JointMeasurement,
    JointMotion,
    LoopPeriods,
    params_from_numbers,
    select_joints,
)

ROBOT = json.loads((files("mjx_starleth") / "starleth.json").read_text())
PARAMS = params_from_numbers(ROBOT)
JOINT_NAMES = [f"{leg}_{joint}" for leg in ROBOT["legs"] for joint in ROBOT["joints"]]
NOMINAL = LoopPeriods()
NO_HOOKS = DriveHooks()

# the oracle's name of a number -> the drive's
FIELDS = {
    "bus": "bus_voltage",
    "power": "power_limit",
    "speed": "speed_limit",
    "c0": "friction_coulomb",
    "I_max": "current_limit",
    "c1": "friction_viscous",
    "k": "spring_stiffness",
    "d": "spring_damping",
    "K": "torque_constant",
}


@dataclass(frozen=True)
class Scenario:
    """A joint, what it is told, torque or position (T,), how its link moves (T,), None: held at zero.

    `changes` are numbers that differ from the robot's, by the oracle's names.
    """

    joint: str
    torque: np.ndarray | None = None  # N m
    position: np.ndarray | None = None  # rad
    link: np.ndarray | None = None  # rad
    changes: dict = field(default_factory=dict)

    @property
    def told(self) -> np.ndarray:
        return self.torque if self.position is None else self.position

    def motion(self) -> np.ndarray:
        """(T, 3) angle, velocity, acceleration of each period: continuous, piecewise quadratic, first at rest."""
        if self.link is None:
            return np.zeros((len(self.told), 3))
        velocity = np.gradient(self.link, NOMINAL.control)
        velocity[0] = 0.0
        change = np.diff(velocity, append=velocity[-1])
        turn = NOMINAL.control * (velocity + 0.5 * change)
        return np.stack([self.link[0] + np.cumsum(turn) - turn, velocity, change / NOMINAL.control], 1)

    def commands(self) -> list[dict]:
        key = "torque" if self.position is None else "position"
        return [{key: float(value)} for value in self.told]

    def params(self) -> DriveParams:
        """One joint's parameters, J = 1."""
        params = select_joints(PARAMS, [JOINT_NAMES.index(self.joint)])
        values = {FIELDS[name]: jnp.asarray([value], jnp.float32) for name, value in self.changes.items()}
        return params._replace(**values)


def play(
    scenario: Scenario,
    drive: str = "full",
    periods: LoopPeriods = NOMINAL,
    hooks: DriveHooks = NO_HOOKS,
    memory: dict | None = None,
) -> dict[str, np.ndarray]:
    """The drive on a scenario with perfect sensors, from rest with empty integrators, (T,) each.

    theta, w, I, torque: at each tick's start; the fields of DriveOutput (its torque as `mean_torque`): over the tick.
    """
    rows = jnp.asarray(scenario.motion(), jnp.float32)[:, :, None]
    told = jnp.asarray(scenario.told, jnp.float32)[:, None]
    mode = jnp.full_like(told, 0.0 if scenario.position is None else 1.0)
    inputs = (JointCommand(told, told, mode), rows[:, 0], rows[:, 1], rows[:, 2])
    now, output = _play(scenario.params(), inputs, memory or {}, drive, periods, hooks)
    found = output._asdict() | now
    return {name: np.asarray(values)[:, 0] for name, values in found.items()}


@partial(jax.jit, static_argnames=("drive", "periods", "hooks"))
def _play(params, inputs, memory, drive, periods, hooks):
    def tick(carry, inputs):
        state, spring = carry
        command, q, qd, qdd = inputs
        measurement = JointMeasurement(q, qd, spring, state.motor_position)
        link = JointMotion(q, qd, qdd, jnp.zeros_like(q))
        now = dict(theta=state.motor_position, w=state.motor_velocity, I=state.current, torque=spring)
        state, output = DRIVES[drive](params, state, (command, measurement, link), hooks, periods)
        return (state, output.end_torque), (now | {"mean_torque": output.torque}, output)

    zero = jnp.zeros_like(inputs[1][0])
    start = DriveState(inputs[1][0], zero, zero, zero, zero, zero, memory)
    return jax.lax.scan(tick, (start, zero), inputs)[1]


def seconds(ticks: int) -> np.ndarray:
    """Times of the ticks, s."""
    return np.arange(ticks) * NOMINAL.control


def chirp(ticks: int, amplitude: float, first_hz: float, last_hz: float) -> np.ndarray:
    """A sine whose frequency grows linearly."""
    t = seconds(ticks)
    return amplitude * np.sin(2 * np.pi * (first_hz + 0.5 * (last_hz - first_hz) * t / t[-1]) * t)


def sway(ticks: int, amplitude: float, hz: float) -> np.ndarray:
    """A link that starts at rest and swings."""
    return amplitude * (1.0 - np.cos(2 * np.pi * hz * seconds(ticks)))
