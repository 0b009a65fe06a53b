"""`starleth bench`: what a 2.5 ms tick of each part costs, side by side with MuJoCo C in one run.

Every entry runs `batch` environments for a number of ticks on all devices, compiled beforehand. The entries take
turns, so that a machine whose speed drifts is slow for all of them; the best round of each counts.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import rollout

from controller_jax.force_distribution import distribute_forces, init_distribution
from controller_jax.force_problem import SupportLegs
from controller_jax.joint_torques import weight_torque
from controller_jax.leg_kinematics import leg_kinematics
from experiments.batch import CHUNK, batched, device_mesh, members_first
from experiments.imu_sensing import make_sensing
from experiments.lanes import lanes
from experiments.model import Model
from experiments.plant import make_plant
from experiments.rollout import Rollout
from experiments.tasks.definition import load_task
from experiments.tasks.registry import make_task
from experiments.trial import nominal_trial
from mjx_starleth.bodies import BodyInput, BodyState
from mjx_starleth.mjcf import mjcf
from mjx_starleth.mjx_quiet import mjx
from mjx_starleth.numbers import RobotNumbers
from sea_jax import JointCommand, JointMeasurement, JointMotion

ROUNDS = 5
CHUNKS_EACH = 4  # of every device in a round: as a generation of 15 candidates under 4 perturbations has on two
KP, KD = 100.0, 2.0  # joint servo of the entries without a controller, as in the MuJoCo C run
# mjx.step's; our own programs cost no less per environment at 16 or 32 than at CHUNK (the closed loop at 32: 1.7 times)
MJX_CHUNK = 16


@dataclass(frozen=True)
class Entry:
    """One thing to time: `run` does batch * ticks env-steps and waits for them."""

    name: str
    batch: int
    ticks: int
    devices: int
    run: Callable[[], Any]


class Program(NamedTuple):
    """`run(shared, member)` does so many ticks of one environment; `member` is a small number that tells them apart."""

    run: Callable[[Any, jax.Array], Any]
    shared: Any
    ticks: int


def entries(model: Model, devices: int, batch: int | None = None) -> list[Entry]:
    """All entries, compiled."""
    mesh, one = device_mesh(jax.devices()[:devices]), device_mesh(jax.devices()[:1])
    found = [mujoco_c(model.numbers, devices)]
    for name, make in (
        ("bodies", bodies),
        ("drive", drives),
        ("force_distribution", force_distribution),
        ("closed_loop", closed_loop),
        ("gait_closed_loop", partial(closed_loop, task="running_trot")),
        ("mjx_step", mjx_step),
    ):
        program = make(model)
        found.append(_entry(name, program, mesh, batch))
        if name == "closed_loop" and devices > 1:
            found.append(_entry(name, program, one, batch))
    return found


def measure(found: list[Entry], rounds: int = ROUNDS) -> Iterator[dict[str, Any]]:
    """One JSON-able line per entry, after all rounds."""
    best = [np.inf] * len(found)
    for entry in found:
        entry.run()
    for _ in range(rounds):
        for i, entry in enumerate(found):
            start = time.perf_counter()
            entry.run()
            best[i] = min(best[i], time.perf_counter() - start)
    speeds = [entry.batch * entry.ticks / seconds for entry, seconds in zip(found, best, strict=True)]
    reference = speeds[0]
    alone = {entry.name: speed for entry, speed in zip(found, speeds, strict=True) if entry.devices == 1}
    for entry, speed in zip(found, speeds, strict=True):
        scaling = {"ratio_to_one_device": round(speed / alone[entry.name], 3)} if entry.name in alone else {}
        yield {
            "name": entry.name,
            "env_steps_per_s": round(speed),
            "devices": entry.devices,
            "batch": entry.batch,
            "ratio_to_mujoco_c": round(speed / reference, 3),
            "microseconds_per_env_step_and_device": round(1e6 * entry.devices / speed, 2),
            **scaling,
        }


def _servo_model(numbers: RobotNumbers) -> mujoco.MjModel:
    """The robot with joint servos and four foot contacts."""
    servos = {"position_gains": (KP, KD), "armature": 0.05}
    return mujoco.MjModel.from_xml_string(mjcf(numbers, solver_iterations=4, cone="pyramidal", **servos))


def mujoco_c(numbers: RobotNumbers, threads: int, batch: int = 512, ticks: int = 200) -> Entry:
    """MuJoCo C's own batched rollout of the same robot with four foot contacts and joint servos."""
    m, (stance, height) = _servo_model(numbers), _stance(numbers)
    d = mujoco.MjData(m)
    d.qpos[2], d.qpos[7:] = height, stance
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(m, kind))
    mujoco.mj_getState(m, d, state, kind)
    states = np.tile(state, (batch, 1))
    states[:, 3] += np.linspace(0, 0.1, batch)
    control = np.tile(stance, (batch, ticks, 1))
    data = [mujoco.MjData(m) for _ in range(threads)]
    return Entry("mujoco_c", batch, ticks, threads, lambda: rollout.rollout(m, data, states, control))


def bodies(model: Model, ticks: int = 400) -> Program:
    """Moreau's step under joint servos, dropped from up to 0.1 m."""
    plant = make_plant(model)
    stance, height = _stance(model.numbers)
    target = jnp.asarray(stance, jnp.float32)
    damping = jnp.full(12, KD, jnp.float32)

    def run(shared, drop):
        q = jnp.concatenate([jnp.stack([0.0 * drop, 0.0 * drop, height + drop]), jnp.eye(4)[0], target])
        state = BodyState(q, jnp.zeros(18), jnp.zeros((4, 3)))

        def tick(state, _):
            torque = KP * (target - state.q[7:]) - KD * state.u[6:]
            state, output = plant.bodies.step(shared.bodies, state, BodyInput(torque, damping))
            return state, output.contact_residual

        state, residual = jax.lax.scan(tick, state, None, length=ticks)
        return state.q[2], residual.max()

    return Program(run, plant.params, ticks)


def drives(model: Model, ticks: int = 400) -> Program:
    """All twelve drives, in torque mode, on moving links."""
    plant = make_plant(model)
    start = plant.initial_state(plant.params, jnp.asarray(plant.bodies.stance), jnp.zeros(12)).drive

    def run(shared, phase):
        def tick(state, k):
            angle = 0.01 * k.astype(jnp.float32) + phase
            q, v = 0.2 * jnp.sin(angle) * jnp.ones(12), 0.8 * jnp.cos(angle) * jnp.ones(12)
            torque = 5.0 * jnp.sin(3.0 * angle) * jnp.ones(12)
            zero = jnp.zeros(12)
            inputs = (
                JointCommand(torque, q, zero),
                JointMeasurement(q, v, zero, state.motor_position),
                JointMotion(q, v, zero, zero),
            )
            state, output = plant.drive_step(shared.drive, state, inputs, periods=plant.periods)
            return state, output.torque.sum()

        return jax.lax.scan(tick, start, jnp.arange(ticks))[1].sum()

    return Program(run, plant.params, ticks)


def force_distribution(model: Model, ticks: int = 400) -> Program:
    """Warm-started force distribution for a wrench that wanders."""
    loop = _loop(model, "squat_jump")
    settings = loop.task.settings
    geometry = settings.geometry
    load = geometry.gravity * loop.plant.params.bodies.mass.sum()
    stance, _ = _stance(model.numbers)
    legs = leg_kinematics(geometry, jnp.asarray(stance, jnp.float32))
    weight = weight_torque(geometry, legs, jnp.eye(3))
    problem = SupportLegs(legs.r_BF_B, legs.J_BF_B, weight, jnp.ones(4))

    def run(shared, phase):
        def tick(state, k):
            angle = 0.02 * k.astype(jnp.float32) + phase
            wave = jnp.sin(angle * jnp.arange(1.0, 7.0))
            wrench = wave * jnp.array([60.0, 60.0, 150.0, 15.0, 15.0, 10.0])
            wrench = wrench + load * jnp.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
            state, forces = distribute_forces(shared.distribution, state, problem, wrench)
            return state, forces.step_left

        return jax.lax.scan(tick, init_distribution(), jnp.arange(ticks))[1].max()

    return Program(run, settings, ticks)


def closed_loop(model: Model, task: str = "squat_jump") -> Program:
    """A task as the search runs it: full drive train, senses, controller, cost terms."""
    loop, initial = _loop(model, task), jnp.asarray(load_task(task).space().initial)

    def run(shared, shift):
        params, settings = shared
        return loop.score(params, settings, initial + 0.05 * shift, nominal_trial()).cost

    return Program(run, (loop.plant.params, loop.task.settings), loop.task.ticks)


def mjx_step(model: Model, ticks: int = 100) -> Program:
    """MJX's own step with its Newton solver; kept at small batches, where it does not hang."""
    m, (stance, height) = _servo_model(model.numbers), _stance(model.numbers)
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        mx, first = mjx.put_model(m), mjx.make_data(m)

    def run(shared, drop):
        with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
            qpos = first.qpos.at[2].set(height + drop).at[7:].set(jnp.asarray(stance, jnp.float32))
            data = first.replace(qpos=qpos, ctrl=jnp.asarray(stance, jnp.float32))

            def tick(data, _):
                return mjx.step(mx, data), None

            return jax.lax.scan(tick, data, None, length=ticks)[0].qpos[2]

    return Program(run, jnp.zeros(()), ticks)


def _entry(name: str, program: Program, mesh: jax.sharding.Mesh, batch: int | None) -> Entry:
    library = name == "mjx_step"
    width, chunk = mesh.devices.size, MJX_CHUNK if library else CHUNK
    size = batch or (chunk * width if library else CHUNKS_EACH * chunk * width)
    members = np.linspace(0.0, 0.1, size, dtype=np.float32)
    run = batched(program.run, mesh, min(chunk, size), members_first if library else lanes)
    return Entry(name, size, program.ticks, width, lambda: run(program.shared, members))


def _loop(model: Model, task: str) -> Rollout:
    definition = load_task(task)
    sensing = make_sensing(definition.stages[-1].sensing, model)
    return Rollout(make_plant(model), make_task(definition, model), sensing)


def _stance(numbers: RobotNumbers) -> tuple[np.ndarray, float]:
    """Joint positions (12,) of the walking stance and its height: FACTS 1, 0.41 m."""
    fore = [0.0, 0.816, -1.484]
    return np.array(fore * 2 + [0.0, -0.816, 1.484] * 2), 0.41
