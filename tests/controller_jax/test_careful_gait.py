"""A gait's careful form: when it is taken, how fast, and that without a reason nothing changes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_locomotion import GEOMETRY, PERIOD, begin, params, robot_state

from controller_jax import careful_gait, locomotion
from controller_jax.careful_gait import CarefulGait, CarefulState, CautionParams
from controller_jax.terrain_estimator import Plane
from controller_jax.velocity_command import VelocityCommand

SLOPE, EXCESS, TILT, RISE, CALM = (0.1, 0.2), (0.4, 0.6), (0.15, 0.3), 0.1, 2.0
CAUTION = CautionParams(*(jnp.float32(x) for x in (SLOPE, EXCESS, TILT, RISE, CALM)))
STILL = VelocityCommand(jnp.float32(0.3), jnp.float32(0.0), jnp.float32(0.0))


@pytest.fixture(scope="module")
def standing():
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        state, body = begin()
        return state._replace(command=STILL), robot_state(body)


def on_slope(state, angle, direction):
    """The gait's state on a plane that rises by `angle` towards `direction`, rad."""
    away = np.sin(angle) * np.array([np.cos(direction), np.sin(direction)])
    normal = jnp.float32([-away[0], -away[1], np.cos(angle)])
    return state._replace(plane=Plane(normal, state.plane.point_W))


@pytest.mark.parametrize("angle, direction", [(0.05, 0.0), (0.15, 1.0), (0.15, -2.5), (0.3, 3.0)])
def test_slopes_of_any_direction_ask_for_care(standing, angle, direction):
    state, robot = standing
    params = CAUTION._replace(tilt=jnp.float32([1.1, 1.2]))
    asked = careful_gait.asked_caution(params, on_slope(state, angle, direction), robot)
    assert float(asked) == pytest.approx(np.interp(np.sin(angle), SLOPE, (0.0, 1.0)), abs=1e-4)


@pytest.mark.parametrize("angle, direction", [(0.1, 0.0), (0.2, 0.5), (0.25, -2.5), (0.6, 3.0)])
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_a_torso_that_leans_any_way_asks_for_care_and_one_that_turns_does_not(standing, angle, direction, yaw):
    state, robot = standing
    leaning = Rotation.from_rotvec(angle * np.array([np.cos(direction), np.sin(direction), 0.0]))
    R_WB = jnp.float32((leaning * Rotation.from_rotvec([0.0, 0.0, yaw])).as_matrix())
    asked = careful_gait.asked_caution(CAUTION, state, robot._replace(R_WB=R_WB))
    assert float(asked) == pytest.approx(np.interp(np.sin(angle), TILT, (0.0, 1.0)), abs=1e-3)


def test_a_torso_along_a_slope_does_not_lean(standing):
    state, robot = standing
    params = CAUTION._replace(slope=jnp.float32([1.1, 1.2]))
    along = jnp.float32(Rotation.from_rotvec([0.3, 0.0, 0.0]).as_matrix())
    state = state._replace(plane=Plane(along[:, 2], state.plane.point_W))
    assert float(careful_gait.asked_caution(params, state, robot._replace(R_WB=along))) == 0.0


@pytest.mark.parametrize("velocity", [(0.3, 0.0), (0.8, 0.0), (0.3, 0.7), (0.0, -1.5), (-0.85, 0.0)])
def test_speed_beyond_the_commanded_asks_for_care_and_a_hop_does_not(standing, velocity):
    state, robot = standing
    robot = robot._replace(v_WB=jnp.float32([*velocity, 0.9]))
    excess = np.hypot(*velocity) - 0.3
    asked = careful_gait.asked_caution(CAUTION, state, robot)
    assert float(asked) == pytest.approx(np.interp(excess, EXCESS, (0.0, 1.0)), abs=1e-4)


def test_a_walk_sideways_that_was_commanded_asks_for_no_care(standing):
    state, robot = standing
    state = state._replace(command=STILL._replace(lateral=jnp.float32(0.8)))
    assert float(careful_gait.asked_caution(CAUTION, state, robot._replace(v_WB=jnp.float32([0.3, 0.8, 0.0])))) == 0.0


def test_a_hop_off_a_slope_is_no_speed_along_it(standing):
    state, robot = standing
    state = on_slope(state, 0.4, 1.0)
    params = CAUTION._replace(slope=jnp.float32([1.0, 1.2]), tilt=jnp.float32([1.0, 1.2]))
    assert float(careful_gait.asked_caution(params, state, robot._replace(v_WB=3.0 * state.plane.normal_W))) == 0.0


def test_a_robot_that_is_put_on_a_slope_takes_care_at_once(standing):
    _, robot = standing
    gait = CarefulGait(params("running_trot"), params("walking_trot"), CAUTION)
    sine, cosine = np.sin(0.15), np.cos(0.15)
    pitched = robot._replace(R_WB=jnp.float32([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]]))
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        first = careful_gait.init(gait, GEOMETRY, pitched)
    assert float(first.caution) == pytest.approx(np.interp(sine, SLOPE, (0.0, 1.0)), abs=1e-3)


def test_care_comes_fast_goes_slowly_and_blends_every_number(standing):
    state, robot = standing
    usual, careful = params("running_trot"), params("walking_trot")
    gait = CarefulGait(usual, careful, CAUTION)
    pushed = robot._replace(v_WB=jnp.float32([0.0, 1.5, 0.0]))
    rest = STILL, jnp.float32(0.0), jnp.float32(PERIOD)
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        after, targets, info = jax.jit(careful_gait.step)(
            gait, GEOMETRY, CarefulState(state, jnp.float32(0.5)), pushed, *rest
        )
        assert float(after.caution) == pytest.approx(0.5 + PERIOD / RISE, abs=1e-6)
        later, *_ = jax.jit(careful_gait.step)(gait, GEOMETRY, after, robot, *rest)
        assert float(later.caution) == pytest.approx(float(after.caution) - PERIOD / CALM, abs=1e-6)
        share = 0.5 + PERIOD / RISE
        between = jax.tree.map(lambda a, b: (1.0 - share) * a + share * b, usual, careful)
        _, wanted, alone = jax.jit(locomotion.step)(between, GEOMETRY, state, pushed, *rest)
    np.testing.assert_allclose(targets.torque, wanted.torque, atol=2e-2)
    np.testing.assert_allclose(info.torso.r_WB, alone.torso.r_WB, atol=1e-5)


def test_without_a_reason_the_gait_is_the_usual_one_to_the_bit(standing):
    state, robot = standing
    usual = params("running_trot")
    gait = CarefulGait(usual, params("walking_trot"), CAUTION)
    rest = STILL, jnp.float32(0.4), jnp.float32(PERIOD)
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        first = careful_gait.init(gait, GEOMETRY, robot)
        assert float(first.caution) == 0.0
        _, targets, info = jax.jit(careful_gait.step)(gait, GEOMETRY, CarefulState(state, first.caution), robot, *rest)
        _, wanted, alone = jax.jit(locomotion.step)(usual, GEOMETRY, state, robot, *rest)
    for mine, its in zip(jax.tree.leaves((targets, info)), jax.tree.leaves((wanted, alone)), strict=True):
        np.testing.assert_allclose(mine, its, rtol=1e-5, atol=1e-4)
