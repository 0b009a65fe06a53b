"""The squat jump in closed loop with MuJoCo C and ideal joint torques, and its phases one by one."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from reference_robot import GEOMETRY, LEGS, reference_model

from controller_jax import squat_jump
from controller_jax.squat_jump_phases import CROUCH, FLIGHT, LANDING, LAUNCH
from controller_jax.squat_jump_settings import SquatJumpParams, default_settings
from controller_jax.types import RobotState

CONTACT_FORCE = 10.0  # N (FACTS 1)
PERIOD = 0.0025
SUBSTEPS = 5
SETTINGS = default_settings(GEOMETRY)
step = jax.jit(squat_jump.step)
PARAMS = SquatJumpParams(
    height_knots=jnp.array([0.26, 0.28, 0.45, 0.55, 0.25, 0.41, 0.30, 0.45]),  # as a search finds them: the torso lags
    foot_knots=jnp.array([0.44, 0.32, 0.43]),
    initial_height=jnp.float32(0.26),
    vertical_damping=jnp.float32(120.0),
)


class Flight(NamedTuple):
    """What a rollout leaves, by tick."""

    phase: np.ndarray
    height: np.ndarray
    load: np.ndarray  # total normal force, N
    tilt: np.ndarray  # rad
    feet: np.ndarray  # (ticks, 4, 3) m
    speed: np.ndarray  # of the torso, m/s


def normal_forces(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Ground's normal force on each foot, N."""
    forces, wrench = np.zeros(4), np.zeros(6)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, wrench)
        name = model.geom(int(max(data.contact[i].geom))).name
        forces[LEGS.index(name)] += wrench[0]
    return forces


def observe(model: mujoco.MjModel, data: mujoco.MjData, contact: np.ndarray) -> RobotState:
    R_WB = data.body("torso").xmat.reshape(3, 3)
    values = (data.qpos[:3], R_WB, data.qvel[:3], data.qvel[3:6], data.qpos[7:], data.qvel[6:], contact)
    return RobotState(*(jnp.asarray(value, jnp.float32) for value in values))


def fly(params: SquatJumpParams, duration: float) -> Flight:
    """Closed loop with ideal torques; in position mode joint PD with the ideal twin's gains (FACTS 2.1)."""
    model = reference_model()
    data = mujoco.MjData(model)
    joints, _ = squat_jump.initial_pose(SETTINGS, params)
    data.qpos[:] = [0, 0, float(params.initial_height), 1, 0, 0, 0, *joints]
    state, log = squat_jump.init(SETTINGS, params), []
    stiffness, damping = np.tile([70.0, 70.0, 26.0], 4), np.tile([3.1, 3.2, 0.2], 4)
    for tick in range(round(duration / PERIOD)):
        mujoco.mj_forward(model, data)
        load = normal_forces(model, data)
        robot = observe(model, data, load >= CONTACT_FORCE)
        state, targets, info = step(SETTINGS, params, state, robot, jnp.float32(tick * PERIOD))
        by_position, wanted, torque = (
            np.asarray(x, float) for x in (targets.position_mode, targets.position, targets.torque)
        )
        for _ in range(SUBSTEPS):
            hold = stiffness * (wanted - data.qpos[7:]) - damping * data.qvel[6:]
            data.qfrc_applied[6:] = np.where(by_position > 0.5, hold, torque)
            mujoco.mj_step(model, data)
        tilt = 2 * np.abs(data.qpos[4:7]).max()
        feet = np.array([data.site(leg).xpos for leg in LEGS])
        log.append((float(info.phase), data.qpos[2], load.sum(), tilt, feet, np.linalg.norm(data.qvel[:3])))
    return Flight(*(np.array(column) for column in zip(*log, strict=True)))


@pytest.fixture(scope="module")
def jump() -> Flight:
    return fly(PARAMS, 2.2)


def test_phases_come_in_order(jump):
    changes = jump.phase[np.flatnonzero(np.diff(jump.phase, prepend=-1.0))]
    assert changes.tolist() == [CROUCH, LAUNCH, FLIGHT, LANDING]


def test_the_robot_waits_in_its_crouch(jump):
    crouch = jump.height[jump.phase == CROUCH]
    np.testing.assert_allclose(crouch, float(PARAMS.initial_height), atol=0.01)


def test_it_jumps_with_its_legs_drawn_in(jump):
    assert jump.height.max() > 0.6
    flying = jump.phase == FLIGHT
    clearance = (jump.feet[flying, :, 2] - 0.02).min(1)
    assert clearance.max() > 0.1


def test_it_lands_once_and_stands_still(jump):
    touch_down = np.flatnonzero(jump.phase == LANDING)[0]
    assert (jump.load[touch_down + 4 :] > 0).all()  # a soft contact may part in the first ticks of the impact
    assert jump.height[touch_down:].min() > 0.2
    standing = slice(-100, None)
    np.testing.assert_allclose(jump.height[standing], float(SETTINGS.landing_height), atol=0.02)
    assert jump.speed[standing].max() < 0.05
    assert jump.tilt.max() < 0.05
    slide = np.linalg.norm(jump.feet[-1, :, :2] - jump.feet[touch_down + 4, :, :2], axis=-1)
    assert slide.max() < 0.02


def test_a_push_without_take_off_ends_standing():
    timid = PARAMS._replace(height_knots=jnp.full(8, 0.30, jnp.float32), initial_height=jnp.float32(0.30))
    stood = fly(timid, 1.8)
    assert FLIGHT not in stood.phase and stood.phase[-1] == LANDING
    np.testing.assert_allclose(stood.height[-40:], float(SETTINGS.landing_height), atol=0.03)


def in_the_air(height: float, rate: float, contact: float) -> RobotState:
    joints, _ = squat_jump.initial_pose(SETTINGS, PARAMS)
    zero = jnp.zeros(3)
    r, v = jnp.array([0.0, 0.0, height]), jnp.array([0.0, 0.0, rate])
    return RobotState(r, jnp.eye(3), v, zero, joints, jnp.zeros(12), jnp.full(4, contact, jnp.float32))


def test_feet_follow_their_spline_under_the_hips_in_flight():
    state = squat_jump.init(SETTINGS, PARAMS)._replace(phase=jnp.float32(LAUNCH), phase_start=jnp.float32(0.3))
    state, targets, info = step(SETTINGS, PARAMS, state, in_the_air(0.48, 2.0, 0.0), jnp.float32(0.6))
    assert info.phase == FLIGHT and targets.position_mode.min() == 1.0
    np.testing.assert_allclose(info.foot_below_hip, PARAMS.foot_knots[0], atol=1e-5)
    duration = (2.0 + np.sqrt(4.0 + 2 * 9.81 * (0.48 - 0.43 - 0.02))) / 9.81
    _, _, info = step(SETTINGS, PARAMS, state, in_the_air(0.6, 0.1, 0.0), jnp.float32(0.6 + duration / 2))
    np.testing.assert_allclose(info.foot_below_hip, PARAMS.foot_knots[1], atol=2e-3)


def test_each_leg_carries_from_its_own_touch_on():
    state = squat_jump.init(SETTINGS, PARAMS)
    state = state._replace(phase=jnp.float32(FLIGHT), landed=jnp.zeros(4), entry=jnp.array([0.48, 2.0]))
    first = in_the_air(0.45, -2.0, 0.0)._replace(contact=jnp.array([1.0, 0.0, 0.0, 0.0]))
    state, targets, info = step(SETTINGS, PARAMS, state, first, jnp.float32(1.0))
    assert info.phase == LANDING
    np.testing.assert_array_equal(info.support, [1, 0, 0, 0])
    np.testing.assert_array_equal(targets.position_mode.reshape(4, 3)[:, 0], [0, 1, 1, 1])
    lost = first._replace(contact=jnp.array([0.0, 1.0, 0.0, 0.0]))
    _, _, info = step(SETTINGS, PARAMS, state, lost, jnp.float32(1.0025))
    np.testing.assert_array_equal(info.support, [1, 1, 0, 0])


@pytest.mark.parametrize("rate", [-0.05, -0.8, -2.5])
def test_landing_height_starts_at_touch_down_stops_in_time_and_ends_standing(rate):
    entry = jnp.array([0.45, rate])
    times = jnp.arange(0.0, 1.2, PERIOD)
    curve = jax.jit(jax.vmap(lambda t: squat_jump._landing_height(SETTINGS, entry, t)))(times)
    np.testing.assert_allclose(curve.value[0], 0.45, atol=1e-6)
    np.testing.assert_allclose(curve.slope[0], rate, atol=1e-6)
    assert curve.value.min() > SETTINGS.lowest_height - 1e-4
    np.testing.assert_allclose(curve.value[-1], SETTINGS.landing_height, atol=1e-5)
    np.testing.assert_allclose(jnp.gradient(curve.value, PERIOD)[1:-1], curve.slope[1:-1], atol=0.05)


@pytest.mark.slow
def test_gradients_are_finite_in_every_phase():
    phases = jnp.array([CROUCH, LAUNCH, FLIGHT, LANDING])
    start = squat_jump.init(SETTINGS, PARAMS)._replace(phase_start=jnp.float32(0.2))

    def effort(params: SquatJumpParams, robot: RobotState, phase: jax.Array) -> jax.Array:
        state = start._replace(phase=phase)
        robot = robot._replace(contact=jnp.where(phase == FLIGHT, 0.0, robot.contact))
        _, targets, info = squat_jump.step(SETTINGS, params, state, robot, jnp.float32(0.3))
        return (targets.torque**2).sum() + (targets.position**2).sum() + (info.tracking_error**2).sum()

    gradient = jax.jit(jax.vmap(jax.grad(effort, (0, 1)), (None, None, 0)))(PARAMS, in_the_air(0.4, 0.0, 1.0), phases)
    assert all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
