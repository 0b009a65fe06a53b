"""Contacts of three squat jumps (data/record_jumps.py) as the step solves them, judged by MuJoCo C in float64.

MuJoCo C gives mass matrix, bias force and foot Jacobians; velocities and laws are worked out from them in NumPy.
"""

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from body_scenarios import bodies, mujoco_robot

from mjx_starleth.bodies import BodyInput, BodyState
from mjx_starleth.names import LEGS

RECORDED = Path(__file__).parents[1] / "data" / "jump_contacts.npz"
PERIOD, RADIUS = 2.5e-3, 0.02
ROUNDING = 5e-5  # of the change of velocity: float32 on mass matrices of condition 1e4
LAW = 1e-4  # m/s, by which the velocity of a foot may miss its law: rounding of speeds up to 5 m/s
RESIDUAL = 0.01  # N, of loads up to 900 N
UNSURE = 1e-6  # m, a gap so near to zero that rounding decides whether it is closed


class Feet(NamedTuple):
    """After the step, in float64; (problems, 4, 3) with x and y along the level ground and z up."""

    velocity: np.ndarray  # m/s
    impulse: np.ndarray  # N s
    gap: np.ndarray  # (problems, 4) at the midpoint, m
    friction: np.ndarray  # (problems, 1)
    miss: np.ndarray  # (problems,) largest difference of the step's velocities to float64, relative to their change


@pytest.fixture(scope="module")
def recorded() -> dict[str, np.ndarray]:
    return dict(np.load(RECORDED))


@pytest.fixture(scope="module")
def stepped(recorded):
    robot = bodies()

    def step(r):
        params = robot.params._replace(friction=r["friction"])
        wrench = jnp.concatenate([r["push"], jnp.zeros(4)])
        state = BodyState(r["q"], r["u"], r["impulse"])
        return robot.step(params, state, BodyInput(r["joint_torque"], r["joint_damping"], wrench))

    return jax.tree.map(lambda x: np.asarray(x, float), jax.jit(jax.vmap(step))(jax.tree.map(np.float32, recorded)))


@pytest.fixture(scope="module")
def feet(recorded, stepped) -> Feet:
    state, output = stepped
    impulse = output.contact_force * PERIOD
    m, d = mujoco_robot()
    rows = []
    for i in range(len(impulse)):
        r = {name: np.asarray(x[i], float) for name, x in recorded.items()}
        u, jacobian, gap = _float64_step(m, d, r, impulse[i])
        miss = np.abs(state.u[i] - u).max() / (1.0 + np.abs(u - r["u"]).max())
        rows.append((jacobian @ u, impulse[i], gap, np.array([r["friction"]]), miss))
    return Feet(*(np.array(column) for column in zip(*rows, strict=True)))


def _float64_step(m, d, r, impulse):
    """u after the step under the given impulses, foot Jacobians (4, 3, 18) and gaps (4,) at the midpoint."""
    q = r["q"].copy()
    mujoco.mj_integratePos(m, q, r["u"], PERIOD / 2)
    d.qpos[:], d.qvel[:] = q, r["u"]
    mujoco.mj_forward(m, d)
    mass, jacobian, gap = np.zeros((18, 18)), np.zeros((4, 3, 18)), np.zeros(4)
    mujoco.mj_fullM(m, d, mass)
    for k, leg in enumerate(LEGS):
        centre = d.site(f"{leg}_foot").xpos
        mujoco.mj_jac(m, d, jacobian[k], None, centre - [0, 0, RADIUS], m.body(f"{leg}_SHANK").id)
        gap[k] = centre[2] - RADIUS

    params = bodies().params
    low, high = np.asarray(params.joint_stop, float).T
    k, c = float(params.stop_stiffness), float(params.stop_damping)
    spring = k * (np.maximum(low - q[7:], 0) + np.minimum(high - q[7:], 0))
    pressing = spring * (spring - c * r["u"][6:]) > 0
    stop = np.where(pressing, PERIOD * k + c, 0.0)
    force = -d.qfrc_bias
    force[:2] += r["push"]
    force[6:] += r["joint_torque"] + np.where(pressing, spring, 0.0) - stop * r["u"][6:]
    mass[range(6, 18), range(6, 18)] += PERIOD * (r["joint_damping"] + stop)
    push = PERIOD * force + np.einsum("kin,ki->n", jacobian, impulse)
    return r["u"] + np.linalg.solve(mass, push), jacobian, gap


def test_the_recording_has_sticking_sliding_and_landing_feet(feet):
    pressed = feet.impulse[..., 2] > 0
    slides = pressed & (np.linalg.norm(feet.velocity[..., :2], axis=-1) > 0.01)
    print(f"\n{len(pressed)} problems, {pressed.sum()} pressed feet, {slides.sum()} of them sliding")
    assert pressed.sum() > 1000 and slides.sum() > 50 and (pressed & ~slides).sum() > 500


def test_velocities_after_the_step_against_float64(feet):
    print(f"\nvelocities: largest difference {feet.miss.max():.1e} of their change")
    assert feet.miss.max() < ROUNDING


def test_every_law_holds_in_float64(feet):
    sure = np.abs(feet.gap) > UNSURE
    closed = feet.gap <= 0
    assert sure.mean() > 0.9
    normal, tangent = feet.impulse[..., 2], np.linalg.norm(feet.impulse[..., :2], axis=-1)
    speed = np.linalg.norm(feet.velocity[..., :2], axis=-1)
    assert not normal[sure & ~closed].any() and not tangent[sure & ~closed].any()
    pressed = normal > 0
    assert normal.min() >= 0 and (feet.velocity[..., 2][sure & closed] > -LAW).all()
    assert np.abs(feet.velocity[..., 2][pressed]).max() < LAW
    assert (tangent - feet.friction * normal).max() < 1e-6
    inside = pressed & (tangent < (1 - 1e-3) * feet.friction * normal)
    assert inside.sum() > 500 and speed[inside].max() < LAW
    slides = pressed & (speed > 100 * LAW)
    along = np.einsum("nki,nki->nk", feet.impulse[..., :2], feet.velocity[..., :2])
    opposed = along + feet.friction * normal * speed
    assert np.abs(opposed[slides] / (feet.friction * normal * speed)[slides]).max() < 1e-3


def test_three_sweeps_leave_almost_nothing(stepped):
    residual = stepped[1].contact_residual
    figures = ", ".join(
        f"{name} {value:.1e}"
        for name, value in zip(("median", "99 %", "largest"), np.quantile(residual, [0.5, 0.99, 1.0]), strict=True)
    )
    print(f"\ncontact residual, N: {figures}")
    assert residual.max() < RESIDUAL
