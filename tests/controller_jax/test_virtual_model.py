"""Virtual model controller and joint torques against MuJoCo's inverse dynamics and eq. 5 written out in NumPy."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from reference_robot import GEOMETRY, LEGS, random_joints, reference_model
from scipy.spatial.transform import Rotation

from controller_jax.joint_torques import joint_torques, weight_torque
from controller_jax.leg_kinematics import leg_kinematics
from controller_jax.rotations import control_frame
from controller_jax.torso_motion import TorsoTarget
from controller_jax.types import RobotState
from controller_jax.virtual_model import Gains, IntegralLimits, gravity_wrench, init_integrals, virtual_model

FORCE_ROUNDING = 2e-3  # N and N m: float32 at 300 N, a few roundings
LIMITS = IntegralLimits(jnp.float32(30.0), jnp.float32(10.0))


def random_state(rng: np.random.Generator) -> RobotState:
    R_WB = Rotation.from_rotvec(rng.normal(0, 0.3, 3)).as_matrix()

    def array(x: np.ndarray) -> jnp.ndarray:
        return jnp.asarray(x, jnp.float32)

    return RobotState(
        array(rng.normal(size=3)), array(R_WB), array(rng.normal(size=3)), array(rng.normal(size=3)),
        array(random_joints(rng)), jnp.zeros(12), jnp.ones(4),
    )  # fmt: skip


def random_target(rng: np.random.Generator, state: RobotState) -> TorsoTarget:
    R = Rotation.from_rotvec(rng.normal(0, 0.4, 3)).as_matrix() @ np.asarray(state.R_WB)
    r, v, a, omega, alpha = (jnp.asarray(rng.normal(size=3), jnp.float32) for _ in range(5))
    return TorsoTarget(state.r_WB + 0.1 * r, v, a, jnp.asarray(R, jnp.float32), omega, alpha)


def here(state: RobotState) -> TorsoTarget:
    """Where the torso is, moving as it moves: no error anywhere."""
    omega_W = jnp.asarray(np.asarray(state.R_WB) @ np.asarray(state.omega_B))
    return TorsoTarget(state.r_WB, state.v_WB, jnp.zeros(3), state.R_WB, omega_W, jnp.zeros(3))


def gains(rng: np.random.Generator) -> Gains:
    diagonals = [jnp.asarray(rng.uniform(10, 500, 3), jnp.float32) for _ in range(6)]
    return Gains(*diagonals, mass=GEOMETRY.torso_mass, inertia=jnp.asarray(rng.uniform(0.1, 2, 3), jnp.float32))


def frame(state: RobotState) -> jnp.ndarray:
    return control_frame(state.R_WB, jnp.array([0.1, 0.05, 1.0]) / np.sqrt(1.0125))


def bias(state: RobotState) -> np.ndarray:
    """MuJoCo's generalised force (18,) that holds the resting robot: base force in W, base torque in B, joints."""
    model = reference_model()
    data = mujoco.MjData(model)
    data.qpos[:3] = state.r_WB
    data.qpos[3:7] = Rotation.from_matrix(np.asarray(state.R_WB)).as_quat(scalar_first=True)
    data.qpos[7:] = state.q
    mujoco.mj_forward(model, data)
    return data.qfrc_bias.copy()


@pytest.mark.parametrize("seed", range(4))
def test_without_error_the_wrench_carries_the_robot(seed):
    state = random_state(np.random.default_rng(seed))
    legs, R_WC = leg_kinematics(GEOMETRY, state.q), frame(state)
    _, wrench = virtual_model(
        gains(np.random.default_rng(seed)), LIMITS, GEOMETRY, init_integrals(), state, legs, here(state), R_WC,
        jnp.float32(0.0),
    )  # fmt: skip
    holding = bias(state)
    np.testing.assert_allclose(np.asarray(R_WC) @ wrench[:3], holding[:3], atol=FORCE_ROUNDING)
    torque_B = np.asarray(state.R_WB).T @ np.asarray(R_WC) @ wrench[3:]
    np.testing.assert_allclose(torque_B, holding[3:6], atol=FORCE_ROUNDING)


@pytest.mark.parametrize("seed", range(4))
def test_wrench_is_equation_5(seed):
    rng = np.random.default_rng(100 + seed)
    state = random_state(rng)
    target, K, period = random_target(rng, state), gains(rng), 0.0025
    legs, R_WC = leg_kinematics(GEOMETRY, state.q), frame(state)
    integrals, wrench = virtual_model(
        K, LIMITS, GEOMETRY, init_integrals(), state, legs, target, R_WC, jnp.float32(period)
    )
    C = np.asarray(R_WC, float).T
    R, R_des = np.asarray(state.R_WB, float), np.asarray(target.R_WB, float)
    e_r, e_v = C @ (np.asarray(target.r_WB) - state.r_WB), C @ (np.asarray(target.v_WB) - state.v_WB)
    e_phi = C @ Rotation.from_matrix(R_des @ R.T).as_rotvec()
    e_w = C @ (np.asarray(target.omega_W) - R @ np.asarray(state.omega_B))
    weight, moment = (np.asarray(x, float) for x in gravity_wrench(GEOMETRY, state, legs, R_WC))
    a, alpha = C @ np.asarray(target.a_WB), C @ np.asarray(target.alpha_W)
    force = K.force_p * e_r + K.force_i * e_r * period + K.force_d * e_v + float(K.mass) * a - weight
    torque = K.torque_p * e_phi + K.torque_i * e_phi * period + K.torque_d * e_w - moment + K.inertia * alpha
    np.testing.assert_allclose(wrench, np.concatenate([force, torque]), atol=FORCE_ROUNDING)
    np.testing.assert_allclose(integrals.force, K.force_i * e_r * period, atol=1e-4)


def test_integrators_stop_at_their_limits():
    rng = np.random.default_rng(7)
    state = random_state(rng)
    target, K = random_target(rng, state), gains(rng)
    legs, R_WC = leg_kinematics(GEOMETRY, state.q), frame(state)
    integrals, _ = virtual_model(K, LIMITS, GEOMETRY, init_integrals(), state, legs, target, R_WC, jnp.float32(100.0))
    np.testing.assert_allclose(np.abs(integrals.force), 30.0)
    np.testing.assert_allclose(np.abs(integrals.torque), 10.0)


@pytest.mark.parametrize("seed", range(4))
def test_joint_torques_balance_any_contact_forces(seed):
    """M 0 + bias = S^T tau + J^T lambda in the joints' rows, for forces that need not carry the robot."""
    rng = np.random.default_rng(200 + seed)
    state = random_state(rng)
    legs = leg_kinematics(GEOMETRY, state.q)
    force_W = rng.normal(0, 80, (4, 3))
    force_B = jnp.asarray(force_W @ np.asarray(state.R_WB), jnp.float32)
    torque = joint_torques(force_B, legs.J_BF_B, weight_torque(GEOMETRY, legs, state.R_WB))
    model = reference_model()
    data = mujoco.MjData(model)
    data.qpos[3:7] = Rotation.from_matrix(np.asarray(state.R_WB)).as_quat(scalar_first=True)
    data.qpos[7:] = state.q
    mujoco.mj_forward(model, data)
    contact = np.zeros(model.nv)
    for leg, force in zip(LEGS, force_W, strict=True):
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, model.site(leg).id)
        contact += jacobian.T @ force
    np.testing.assert_allclose(torque + contact[6:], data.qfrc_bias[6:], atol=FORCE_ROUNDING)
