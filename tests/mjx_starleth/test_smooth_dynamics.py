"""Kinematics, mass matrix, bias force and foot Jacobians of both implementations against MuJoCo C."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from body_scenarios import bodies, mujoco_robot, random_state

from mjx_starleth.foot_jacobian import foot_jacobian
from mjx_starleth.names import LEGS
from mjx_starleth.terrain import contact_frame, slope_normal

ROUNDING = 3e-6  # float32 against float64, relative to the largest entry; sums of 13 bodies


def perturbed(params, seed):
    rng = np.random.default_rng(seed)
    return params._replace(
        mass=np.float32(params.mass * rng.uniform(0.8, 1.2, 13)),
        com=np.float32(params.com + rng.normal(size=(13, 3)) * 0.02),
        inertia=np.float32(params.inertia * rng.uniform(0.95, 1.05, (13, 1))),
        gravity=np.float32([0.5, -1.0, -9.0]),
    )


def in_mujoco(params, q, u):
    m, d = mujoco_robot()
    m.body_mass[1:], m.body_ipos[1:], m.body_inertia[1:] = params.mass, params.com, params.inertia
    m.opt.gravity[:] = params.gravity
    mujoco.mj_setConst(m, d)
    d.qpos[:], d.qvel[:] = q, u
    mujoco.mj_forward(m, d)
    return m, d


def close(ours, oracle):
    oracle = np.asarray(oracle)
    np.testing.assert_allclose(ours, oracle, atol=ROUNDING * np.abs(oracle).max())


@pytest.fixture(scope="module", params=["legs", "mjx"])
def robot(request):
    chosen = bodies(dynamics=request.param)
    return chosen, jax.jit(chosen.smooth)


@pytest.mark.parametrize("seed", range(4))
def test_against_mujoco_c(robot, seed):
    chosen, smooth = robot
    params, (q, u) = perturbed(chosen.params, seed), random_state(seed)
    s = smooth(params, q, u)
    m, d = in_mujoco(params, q, u)

    mass = np.zeros((18, 18))
    mujoco.mj_fullM(m, d, mass)
    close(s.m_base, mass[:6, :6])
    for leg in range(4):
        rows = slice(6 + 3 * leg, 9 + 3 * leg)
        close(s.cross[leg], mass[rows, :6])
        close(s.m_leg[leg], mass[rows, rows])
    close(s.bias, d.qfrc_bias)
    close(s.r_WF, [d.site(f"{leg}_foot").xpos for leg in LEGS])
    close(s.r_WC, d.xipos[1:])
    close(s.axis.reshape(12, 3), d.xaxis[1:])
    close(s.anchor.reshape(12, 3), d.xanchor[1:])


@pytest.mark.parametrize("seed", range(3))
def test_foot_jacobian_against_mujoco_c(robot, seed):
    chosen, smooth = robot
    q, u = random_state(seed)
    m, d = in_mujoco(chosen.params, q, u)
    frame = np.asarray(contact_frame(np.float32([slope_normal(0.4, seed + leg) for leg in range(4)])))
    radius = np.float32(0.02)
    jacobian = foot_jacobian(smooth(chosen.params, q, u), jnp.asarray(frame), jnp.asarray(q[:3]), radius)
    for leg, name in enumerate(LEGS):
        point, full = d.site(f"{name}_foot").xpos - radius * frame[leg, 2], np.zeros((3, 18))
        mujoco.mj_jac(m, d, full, None, point, m.body(f"{name}_SHANK").id)
        full = frame[leg] @ full
        close(jacobian.base[leg], full[:, :6])
        close(jacobian.leg[leg], full[:, 6 + 3 * leg : 9 + 3 * leg])
        close(jacobian.velocity(jnp.asarray(u))[leg], full @ u)


def test_energy_against_mujoco_c(robot):
    chosen, _ = robot
    q, u = random_state(7)
    m, d = in_mujoco(chosen.params, q, u)
    mujoco.mj_energyPos(m, d)
    mujoco.mj_energyVel(m, d)
    state = chosen.initial_state()._replace(q=jnp.asarray(q), u=jnp.asarray(u))
    np.testing.assert_allclose(jax.jit(chosen.energy)(chosen.params, state), d.energy[::-1], rtol=1e-5)
