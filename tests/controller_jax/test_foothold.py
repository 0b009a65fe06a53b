"""Footholds against the sum of vectors of Fig. 3, written out leg by leg in NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from controller_jax.foothold import FootholdParams, desired_footholds
from controller_jax.geometry import geometry_from_numbers
from controller_jax.rotations import control_frame
from controller_jax.terrain_estimator import Plane
from controller_jax.types import RobotState
from controller_jax.velocity_command import VelocityCommand
from mjx_starleth.numbers import load_numbers

GEOMETRY = geometry_from_numbers(load_numbers().model_dump(mode="json"))
HIPS = np.array([[0.2525, 0.185, 0], [0.2525, -0.185, 0], [-0.2525, 0.185, 0], [-0.2525, -0.185, 0]])
LEG_LENGTH = 0.0685 + 0.2 + 0.235
TOLERANCE = 1e-5  # m, float32 sums of a few metres
UP = np.array([0, 0, 1.0])


def oracle(p, case):
    """Foothold of every leg by the rules of FACTS 3.4, the hip carried on until touch-down."""
    n, point, R, r = case["normal"], case["point"], case["R_WB"], case["r_WB"]
    x = R[:, 0] - (R[:, 0] @ n) * n
    ex = x / np.linalg.norm(x)
    ey = np.cross(n, ex)
    vx, vy, turning = case["command"]
    result = []
    for leg in range(4):
        lever_arm = R @ HIPS[leg]
        hip = r + lever_arm
        along_gravity = ((hip - point) @ n) / n[2]
        strut = hip - along_gravity * UP
        lever = hip - ((hip - point) @ n) * n
        start = (1 - p["lever"]) * strut + p["lever"] * lever
        v_hip = case["v"] + np.cross(R @ case["omega_B"], lever_arm)
        v_ref = 0.5 * (v_hip + case["v"])
        wanted = np.array([vx, vy]) + turning * np.array([-lever_arm @ ey, lever_arm @ ex])
        measured = np.array([v_ref @ ex, v_ref @ ey])
        side, end = (1, -1)[leg % 2], leg // 2
        offset = np.array([p["heading_offset"][end], side * p["lateral_offset"][end]])
        step = p["feed_forward"] * wanted * case["stance"][leg]
        step = step + np.array(p["feedback"]) * (measured - wanted) * np.sqrt(along_gravity / 9.81)
        step = np.clip(offset + step, -p["reach"] * LEG_LENGTH, p["reach"] * LEG_LENGTH)
        step = step + case["remaining"][leg] * np.array([v_hip @ ex, v_hip @ ey])
        result.append(start + step[0] * ex + step[1] * ey)
    return np.array(result)


def random_case(rng, level=False):
    tilt = 0.0 if level else 0.35
    normal = Rotation.from_euler("xy", rng.uniform(-tilt, tilt, 2)).apply(UP)
    return dict(
        normal=normal,
        point=rng.uniform(-1, 1, 3),
        R_WB=Rotation.from_euler("ZYX", [rng.uniform(-3, 3), *rng.uniform(-0.3, 0.3, 2)]).as_matrix(),
        r_WB=rng.uniform(-1, 1, 3) + 2 * UP,
        v=rng.uniform(-1, 1, 3),
        omega_B=rng.uniform(-1, 1, 3),
        command=rng.uniform(-0.8, 0.8, 3),
        stance=rng.uniform(0.1, 0.5, 4),
        remaining=rng.uniform(0, 0.4, 4),
    )


PARAMS = dict(
    lever=0.0,
    feed_forward=0.5,
    feedback=[1.1, 0.8],
    heading_offset=[-0.05, 0.07],
    lateral_offset=[0.01, 0.03],
    reach=0.5,
)


@jax.jit
def run(p, case):
    plane = Plane(case["normal"], case["point"])
    zero = jnp.zeros(12)
    state = RobotState(case["r_WB"], case["R_WB"], case["v"], case["omega_B"], zero, zero, jnp.zeros(4))
    R_WC = control_frame(case["R_WB"], case["normal"])
    command = VelocityCommand(*case["command"])
    return desired_footholds(p, GEOMETRY, state, R_WC, plane, command, case["stance"], case["remaining"])


def footholds(p, case):
    as_float32 = lambda tree: {k: jnp.asarray(v, jnp.float32) for k, v in tree.items()}  # noqa: E731
    return np.asarray(run(FootholdParams(**as_float32(p)), as_float32(case)))


@pytest.mark.parametrize("lever", [0.0, 1.0, 0.4])
def test_footholds_are_the_sum_of_their_parts(lever):
    rng = np.random.default_rng(0)
    for _ in range(50):
        p, case = PARAMS | {"lever": lever}, random_case(rng)
        found = footholds(p, case)
        np.testing.assert_allclose(found, oracle(p, case), atol=TOLERANCE)
        np.testing.assert_allclose((found - case["point"]) @ case["normal"], 0, atol=TOLERANCE)


def test_reach_bounds_the_step_but_not_the_way_to_touch_down():
    case = random_case(np.random.default_rng(1), level=True)
    case |= dict(v=np.array([50.0, 0, 0]), omega_B=np.zeros(3), R_WB=np.eye(3), remaining=np.zeros(4))
    found = footholds(PARAMS, case)
    np.testing.assert_allclose(found[:, 0] - (case["r_WB"] + HIPS)[:, 0], 0.5 * LEG_LENGTH, atol=TOLERANCE)


def test_strut_and_lever_part_on_a_slope_only():
    rng = np.random.default_rng(2)
    flat, slope = random_case(rng, level=True), random_case(rng)
    differ = [np.abs(footholds(PARAMS, c) - footholds(PARAMS | {"lever": 1.0}, c)).max() for c in (flat, slope)]
    assert differ[0] < TOLERANCE and differ[1] > 0.05
