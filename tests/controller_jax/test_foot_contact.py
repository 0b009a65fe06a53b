"""Forces act at the soles: Jacobian and torques of a spherical foot on a slope against MuJoCo C."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from reference_robot import GEOMETRY, LEGS, reference_model
from scipy.spatial.transform import Rotation

from controller_jax.foot_contact import soles
from controller_jax.force_problem import support_legs
from controller_jax.joint_torques import joint_torques, weight_torque
from controller_jax.leg_kinematics import leg_kinematics
from controller_jax.rotations import control_frame

SLOPE = np.array([-np.sin(0.37), 0.0, np.cos(0.37)])  # normal of a ground that rises ahead, 21 degrees


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return reference_model()


def placed(model, seed):
    """A robot in any posture, in MuJoCo C and as the controller sees it: (data, R_WB, q)."""
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    turn = Rotation.from_rotvec(rng.normal(0, 0.3, 3))
    q = np.array([0.1, 0.8, -1.2, -0.1, 0.6, -1.0, 0.2, -0.9, 1.4, -0.2, -0.7, 1.1]) + rng.normal(0, 0.1, 12)
    data.qpos[3:7] = np.roll(turn.as_quat(), 1)
    data.qpos[7:] = q
    mujoco.mj_forward(model, data)
    return data, turn.as_matrix().astype(np.float32), q.astype(np.float32)


@pytest.mark.parametrize("seed", range(3))
def test_soles_and_their_jacobians_agree_with_mujoco(model, seed):
    data, R_WB, q = placed(model, seed)
    qd = np.random.default_rng(seed).normal(0, 2, 12).astype(np.float32)
    feet = soles(GEOMETRY, leg_kinematics(GEOMETRY, jnp.asarray(q)), q, qd, jnp.asarray(R_WB), jnp.asarray(SLOPE))
    for k, leg in enumerate(LEGS):
        point = data.site(leg).xpos - float(GEOMETRY.foot_radius) * SLOPE
        np.testing.assert_allclose(R_WB @ feet.r_BS_B[k], point - data.qpos[:3], atol=1e-5)
        J = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, J, None, point, model.body(f"{leg}_shank").id)
        np.testing.assert_allclose(R_WB @ feet.J_BS_B[k], J[:, 6 + 3 * k : 9 + 3 * k], atol=1e-5)
        np.testing.assert_allclose(R_WB @ feet.v_BS_B[k], J[:, 6:] @ qd, atol=1e-4)


def test_torques_of_an_upright_force_on_a_slope_are_those_of_statics(model):
    """Every joint's torque is the moment of the force about its axis: of one that acts where the foot touches."""
    data, R_WB, q = placed(model, 7)
    legs = leg_kinematics(GEOMETRY, jnp.asarray(q))
    R_WC = control_frame(jnp.asarray(R_WB), jnp.asarray(SLOPE))
    feet = soles(GEOMETRY, legs, q, jnp.zeros(12), jnp.asarray(R_WB), jnp.asarray(SLOPE))
    force_W = np.array([0.0, 0.0, 125.0])
    support = support_legs(GEOMETRY, legs, jnp.asarray(R_WB), R_WC, jnp.ones(4), feet)
    force_C = np.broadcast_to(R_WC.T @ force_W, (4, 3)).astype(np.float32)
    weight = weight_torque(GEOMETRY, legs, jnp.asarray(R_WB))
    torque = np.asarray(joint_torques(force_C, support.J_BF_C, weight) - weight.reshape(12)).reshape(4, 3)
    for k, leg in enumerate(LEGS):
        point = data.site(leg).xpos - float(GEOMETRY.foot_radius) * SLOPE
        moments = [data.xaxis[1 + 3 * k + j] @ np.cross(point - data.xanchor[1 + 3 * k + j], force_W) for j in range(3)]
        np.testing.assert_allclose(torque[k], -np.array(moments), atol=2e-3)
