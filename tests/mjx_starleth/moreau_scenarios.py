"""Scenarios of the time step, all in one compiled program: scenario x step size is its batch axis."""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from body_scenarios import NUMBERS, bodies, mujoco_robot

from mjx_starleth.bodies import BodyInput, BodyParams, BodyState
from mjx_starleth.mujoco_c import MujocoC

STEP_SIZES = np.float32([5e-3, 2.5e-3, 1.25e-3, 0.625e-3])  # s
DURATION = 0.25  # s
NOMINAL = 1  # index of the step that the simulation takes
# One rigid body on four feet: the forces are not unique, and Gauss-Seidel is slowest. Legs need 3 sweeps.
SWEEPS = 60
LOCK = 1e7  # N m s/rad, a joint that carries 10 N m creeps at 1e-6 rad/s


class Scenario(NamedTuple):
    """Joints are servos: torque - stiffness (q - q_start) - damping u."""

    params: BodyParams
    q: np.ndarray  # (19,)
    u: np.ndarray  # (18,)
    torque: np.ndarray  # (12,) N m
    stiffness: np.ndarray  # () N m/rad
    damping: np.ndarray  # () N m s/rad
    wrench_W: np.ndarray  # (6,)


class Motion(NamedTuple):
    """One scenario at one step size, after each step; everything as float64."""

    h: float
    q: np.ndarray  # (steps, 19)
    u: np.ndarray  # (steps, 18)
    force: np.ndarray  # (steps, 4, 3)
    residual: np.ndarray  # (steps,)

    def at(self, time: float) -> int:
        return round(time / self.h) - 1


def scenario(q=None, u=None, torque=None, stiffness=0.0, damping=0.0, wrench_W=None, **params) -> Scenario:
    """The default stance at rest on its ground; `params` replace the nominal ones."""
    fill = lambda x, n: np.zeros(n, np.float32) if x is None else np.float32(x)  # noqa: E731
    robot = bodies()
    start = robot.stance if q is None else np.float32(q)
    numbers = jax.tree.map(np.float32, robot.params._replace(**params))
    servo = np.float32(stiffness), np.float32(damping)
    return Scenario(numbers, start, fill(u, 18), fill(torque, 12), *servo, fill(wrench_W, 6))


def turned(q: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """The robot moved with the world about its origin by a quaternion."""
    place, orientation = np.zeros(3), np.zeros(4)
    mujoco.mju_rotVecQuat(place, np.asarray(q[:3], float), rotation)
    mujoco.mju_mulQuat(orientation, rotation, np.asarray(q[3:7], float))
    return np.concatenate([place, orientation, q[7:]])


@cache
def _program():
    robot, steps = replace(bodies(), sweeps=SWEEPS), round(DURATION / float(STEP_SIZES.min()))

    def run(s: Scenario, h):
        stepper = replace(robot, period=h)
        damping = jnp.broadcast_to(s.damping, (12,))

        def step(state, _):
            torque = s.torque - s.stiffness * (state.q[7:] - s.q[7:]) - s.damping * state.u[6:]
            state, out = stepper.step(s.params, state, BodyInput(torque, damping, s.wrench_W))
            return state, (state.q, state.u, out.contact_force, out.contact_residual)

        return jax.lax.scan(step, BodyState(s.q, s.u, jnp.zeros((4, 3))), None, length=steps)[1]

    return jax.jit(jax.vmap(jax.vmap(run, (None, 0)), (0, None)))


def simulate_all(scenarios: dict[str, Scenario]) -> dict[str, list[Motion]]:
    """By name, the motion at each of STEP_SIZES over DURATION."""
    batch = jax.tree.map(lambda *rows: np.stack(rows), *scenarios.values())
    found = [np.asarray(x, float) for x in _program()(batch, STEP_SIZES)]
    motions = {}
    for i, name in enumerate(scenarios):
        motions[name] = []
        for k, h in enumerate(STEP_SIZES):
            steps = round(DURATION / float(h))
            motions[name].append(Motion(DURATION / steps, *(x[i, k, :steps] for x in found)))
    return motions


def in_mujoco(s: Scenario, step: float) -> tuple[np.ndarray, np.ndarray]:
    """q, u of the scenario at its end, by MuJoCo C with its own contact, `step` s."""
    period = float(STEP_SIZES[NOMINAL])
    engine = MujocoC(NUMBERS, s.params, period=period, substep=step)
    state = BodyState(s.q, s.u, np.zeros((4, 3)))
    servo = lambda _, q, u: s.torque - s.stiffness * (q - s.q[7:]) - s.damping * u  # noqa: E731
    for _ in range(round(DURATION / period)):
        state, _ = engine.step(state, BodyInput(np.zeros(12), wrench_W=s.wrench_W), servo)
    return engine.data.qpos.copy(), engine.data.qvel.copy()


def free_in_mujoco(s: Scenario, step: float = 1e-4) -> tuple[np.ndarray, np.ndarray]:
    """q, u of a scenario without contact or servos at its end, by MuJoCo's Runge-Kutta of fourth order."""
    m, d = mujoco_robot()
    m.opt.integrator, m.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, step
    m.opt.gravity[:] = s.params.gravity
    d.qpos[:], d.qvel[:] = s.q, s.u
    rotation = np.zeros(9)
    for _ in range(round(DURATION / step)):
        mujoco.mju_quat2Mat(rotation, d.qpos[3:7])
        d.qfrc_applied[:3] = s.wrench_W[:3]
        d.qfrc_applied[3:6] = rotation.reshape(3, 3).T @ s.wrench_W[3:]
        d.qfrc_applied[6:] = s.torque
        mujoco.mj_step(m, d)
    return d.qpos.copy(), d.qvel.copy()


def invariants(params: BodyParams, q: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, float]:
    """Angular momentum (3,) about the centre of mass and mechanical energy, by MuJoCo C."""
    m, d = mujoco_robot()
    m.opt.gravity[:] = params.gravity
    d.qpos[:], d.qvel[:] = q, u
    mujoco.mj_forward(m, d)
    mujoco.mj_subtreeVel(m, d)
    mujoco.mj_energyPos(m, d)
    mujoco.mj_energyVel(m, d)
    return d.subtree_angmom[1].copy(), float(d.energy.sum())
