"""Leg kinematics against MuJoCo C and by round trips."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from reference_robot import GEOMETRY, LEGS, LIMITS, NUMBERS, random_joints, reference_model

from controller_jax.geometry import geometry_from_numbers
from controller_jax.leg_kinematics import (
    MIN_DROP,
    inverse_kinematics,
    leg_kinematics,
    leg_mass,
)

POSITION_TOLERANCE = 2e-6  # m: a few roundings of float32 at 0.5 m
ANGLE_TOLERANCE = 2e-4  # rad: float32 rounding of the knee's cosine, worst near the stretched leg


@pytest.fixture(scope="module")
def mujoco_robot() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = reference_model()
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("seed", range(5))
def test_feet_and_centres_of_mass_agree_with_mujoco(mujoco_robot, seed):
    model, data = mujoco_robot
    q = random_joints(np.random.default_rng(seed))
    data.qpos[:] = [0, 0, 0, 1, 0, 0, 0, *q]
    mujoco.mj_forward(model, data)
    legs = jax.jit(leg_kinematics)(GEOMETRY, jnp.asarray(q))
    for i, leg in enumerate(LEGS):
        site = model.site(leg).id
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, site)
        np.testing.assert_allclose(legs.r_BF_B[i], data.site_xpos[site], atol=POSITION_TOLERANCE)
        columns = slice(6 + 3 * i, 9 + 3 * i)
        np.testing.assert_allclose(legs.J_BF_B[i], jacobian[:, columns], atol=POSITION_TOLERANCE)
        hip = model.body(f"{leg}_hip").id
        mujoco.mj_jacSubtreeCom(model, data, jacobian, hip)
        np.testing.assert_allclose(legs.r_BG_B[i], data.subtree_com[hip], atol=POSITION_TOLERANCE)
        np.testing.assert_allclose(legs.J_BG_B[i], jacobian[:, columns], atol=POSITION_TOLERANCE)
        np.testing.assert_allclose(leg_mass(GEOMETRY), model.body_subtreemass[hip], rtol=1e-6)


def test_inverse_kinematics_finds_the_joints_back():
    rng = np.random.default_rng(0)
    q = jnp.asarray(np.stack([random_joints(rng) for _ in range(2000)]))
    legs = jax.vmap(lambda x: leg_kinematics(GEOMETRY, x))(q)
    HFE, KFE = q.reshape(-1, 4, 3)[..., 1], q.reshape(-1, 4, 3)[..., 2]
    drop = 0.2 * jnp.cos(HFE) + 0.235 * jnp.cos(HFE + KFE)
    HAA = q.reshape(-1, 4, 3)[..., 0]
    below = jnp.cos(HAA) * (0.0685 + drop) > 0.0685 + MIN_DROP
    found = jax.vmap(lambda r: inverse_kinematics(GEOMETRY, r))(legs.r_BF_B)
    error = jnp.abs(found - q).reshape(-1, 4, 3).max(-1)
    assert below.mean() > 0.5
    assert jnp.where(below, error, 0.0).max() < ANGLE_TOLERANCE


def test_default_stance_is_that_of_the_robot_file():
    stance = NUMBERS["default_stance"]
    feet = GEOMETRY.r_BH_B - jnp.array([[0.0, 0.0, stance["base_height"]]])
    # FACTS tabulates this pose for the height of the foot's centre; the file repeats it
    q = inverse_kinematics(GEOMETRY, feet).reshape(4, 3)
    expected = np.array([stance["LF"][joint] for joint in ("HAA", "HFE", "KFE")])
    np.testing.assert_allclose(q[0], expected, atol=1e-3)
    np.testing.assert_allclose(q[3], expected * [-1, -1, -1], atol=1e-3)


def test_targets_out_of_reach_stay_finite_and_within_limits():
    targets = jnp.asarray(np.random.default_rng(1).uniform(-1, 1, (500, 4, 3)), jnp.float32)
    targets = targets.at[0].set(GEOMETRY.r_BH_B).at[1].set(GEOMETRY.r_BH_B - jnp.array([[0.0, 0.0, 0.5035]]))
    both = lambda r: (inverse_kinematics(GEOMETRY, r), jax.jacrev(inverse_kinematics, 1)(GEOMETRY, r))  # noqa: E731
    q, jacobian = jax.jit(jax.vmap(both))(targets)
    assert jnp.isfinite(q).all() and jnp.isfinite(jacobian).all()
    assert (np.asarray(q) >= LIMITS[:, 0]).all() and (np.asarray(q) <= LIMITS[:, 1]).all()


def test_limits_mirror_in_the_x_configuration():
    margin = 0.05
    np.testing.assert_allclose(LIMITS[2], [-2.46 + margin, -0.10 - margin], atol=1e-6)
    np.testing.assert_allclose(LIMITS[3], [-0.50 + margin, 0.40 - margin], atol=1e-6)
    np.testing.assert_allclose(LIMITS[8], [0.10 + margin, 2.46 - margin], atol=1e-6)
    np.testing.assert_allclose(GEOMETRY.torque_limits[2], [0, 30])
    np.testing.assert_allclose(GEOMETRY.torque_limits[11], [-30, 0])


@pytest.mark.parametrize("broken", [{}, {**NUMBERS, "gravity": float("nan")}, {**NUMBERS, "bodies": 3}])
def test_broken_numbers_are_refused_in_one_sentence(broken):
    with pytest.raises(ValueError, match="robot's numbers"):
        geometry_from_numbers(broken)
