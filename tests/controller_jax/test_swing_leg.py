"""Swing motion against its stated timing and SciPy's Hermite splines; joint commands against finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from controller_jax import swing_leg
from controller_jax.geometry import geometry_from_numbers
from controller_jax.leg_kinematics import inverse_kinematics, leg_kinematics
from controller_jax.terrain_estimator import Plane
from controller_jax.types import RobotState
from mjx_starleth.numbers import load_numbers

GEOMETRY = geometry_from_numbers(load_numbers().model_dump(mode="json"))
TOLERANCE = 2e-6  # m, float32 of half a metre
DURATION, LATE = 0.4, 0.2  # s, and the phase at which the feet really left the ground


def params(**changes):
    values = dict(
        apex_height=0.09, landing_height=0.0, heading_end=0.6, lateral_start=0.3, lateral_end=0.8,
        position_lead=[0.0, 0.0, 0.0], joint_speed_limit=10.0,
    ) | changes  # fmt: skip
    return swing_leg.SwingParams(**{k: jnp.asarray(v, jnp.float32) for k, v in values.items()})


def on_slope():
    """A tilted ground, a step of each leg on it whose start is off the plane, all in NumPy."""
    R_WC = Rotation.from_euler("ZYX", [0.7, 0.2, -0.1]).as_matrix()
    point = np.array([0.3, -0.2, 0.1])
    rng = np.random.default_rng(0)
    start_C = np.column_stack([rng.uniform(-0.3, 0.3, (4, 2)), [0.0, 0.03, -0.02, 0.05]])
    end_C = np.column_stack([rng.uniform(-0.3, 0.3, (4, 2)), np.zeros(4)])
    return R_WC, point, start_C, end_C


@jax.jit
def motion_at(p, start, end, phase, R_WC, plane, clearance):
    duration = jnp.full(4, DURATION, jnp.float32)
    phase = jnp.full(4, phase)
    progress = (phase - LATE) / (1.0 - LATE)
    return swing_leg.swing_motion(p, start, end, phase, progress, duration, R_WC, plane, clearance)


def trace(p, phases, clearance=0.0):
    """Positions and velocities in the control frame, (phases, 4, 3) each."""
    R_WC, point, start_C, end_C = on_slope()
    f = lambda x: jnp.asarray(x, jnp.float32)  # noqa: E731
    plane = Plane(f(R_WC[:, 2]), f(point))
    arguments = f(start_C @ R_WC.T + point), f(end_C @ R_WC.T + point)
    run = jax.vmap(lambda s: motion_at(p, *arguments, s, f(R_WC), plane, jnp.full(4, clearance, jnp.float32)))
    motion = run(f(phases))
    return (np.asarray(motion.position) - point) @ R_WC, np.asarray(motion.velocity) @ R_WC


def test_each_direction_is_its_hermite_spline():
    phases = np.linspace(0, 1, 101)
    r, v = trace(params(), phases)
    _, _, start, end = on_slope()
    for leg in range(4):
        top = max(start[leg, 2], end[leg, 2]) + 0.09
        knots = (
            (LATE + (1 - LATE) * np.array([0, 0.6]), [start[leg, 0], end[leg, 0]]),
            (LATE + (1 - LATE) * np.array([0.3, 0.8]), [start[leg, 1], end[leg, 1]]),
            ([0, 0.5, 1], [start[leg, 2], top, end[leg, 2]]),
        )
        for axis, (x, y) in enumerate(knots):
            spline = CubicHermiteSpline(x, y, np.zeros(len(x)))
            inside = np.clip(phases, x[0], x[-1])
            np.testing.assert_allclose(r[:, leg, axis], spline(inside), atol=TOLERANCE)
            moving = (phases > x[0]) & (phases < x[-1])
            rate = np.where(moving, spline(inside, 1), 0.0) / DURATION
            np.testing.assert_allclose(v[:, leg, axis], rate, atol=1e-4)


def test_foot_is_at_rest_at_both_ends_and_obstacle_clearance_raises_the_apex():
    _, v = trace(params(), [0.0, 1.0])
    assert np.abs(v).max() < 1e-5
    low, high = trace(params(), [0.5])[0], trace(params(), [0.5], clearance=0.05)[0]
    np.testing.assert_allclose(high - low, np.broadcast_to([0, 0, 0.05], (1, 4, 3)), atol=TOLERANCE)


def test_foot_ends_above_the_ground_by_the_landing_height():
    low, high = (trace(params(landing_height=h), [0.3, 1.0])[0] for h in (0.0, 0.01))
    np.testing.assert_allclose((high - low)[1], np.broadcast_to([0, 0, 0.01], (4, 3)), atol=TOLERANCE)
    assert np.abs(trace(params(landing_height=0.01), [0.0, 1.0])[1]).max() < 1e-5


def robot(seed):
    rng = np.random.default_rng(seed)
    f = lambda x: jnp.asarray(x, jnp.float32)  # noqa: E731
    stance = np.array([0.0, 0.7, -1.3] * 2 + [0.0, -0.7, 1.3] * 2)
    R = Rotation.from_euler("ZYX", rng.uniform(-0.3, 0.3, 3)).as_matrix()
    q = stance + rng.uniform(-0.15, 0.15, 12)
    return RobotState(
        f(rng.uniform(-1, 1, 3)), f(R), f(rng.uniform(-0.5, 0.5, 3)), f(rng.uniform(-0.5, 0.5, 3)),
        f(q), jnp.zeros(12), jnp.zeros(4),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_joint_commands_lead_the_inverse_kinematics_by_the_joint_velocity(seed):
    """The led command is where the joints that follow the feet will be after the lead, to first order."""
    state = robot(seed)
    legs = leg_kinematics(GEOMETRY, state.q)
    rng = np.random.default_rng(seed + 10)
    velocity = rng.uniform(-0.5, 0.5, (4, 3)).astype(np.float32)
    normal = jnp.asarray([0.0, 0.0, 1.0])
    R, r = np.asarray(state.R_WB, float), np.asarray(state.r_WB, float)
    centre = r + np.asarray(legs.r_BF_B, float) @ R.T
    sole = centre - 0.02 * np.array([0, 0, 1.0])
    motion = swing_leg.FootMotion(jnp.asarray(sole, jnp.float32), jnp.asarray(velocity))
    lead = 0.002
    command = swing_leg.joint_positions(params(position_lead=[lead] * 3), GEOMETRY, state, legs, motion, normal)
    turn = Rotation.from_rotvec(lead * np.asarray(state.omega_B, float)).as_matrix()
    R_later, r_later = R @ turn, r + lead * np.asarray(state.v_WB, float)
    feet_later = (centre + lead * velocity - r_later) @ R_later
    later = inverse_kinematics(GEOMETRY, jnp.asarray(feet_later, jnp.float32))
    np.testing.assert_allclose(command, later, atol=2e-4)  # second order: (2 ms x 5 rad/s)^2
    unled = swing_leg.joint_positions(params(), GEOMETRY, state, legs, motion, normal)
    np.testing.assert_allclose(unled, state.q, atol=1e-4)


def test_legs_are_solved_like_numpy_does():
    rng = np.random.default_rng(0)
    legs = leg_kinematics(GEOMETRY, robot(0).q)
    v = rng.standard_normal((4, 3))
    oracle = np.linalg.solve(np.asarray(legs.J_BF_B, float), v[..., None])[..., 0]
    np.testing.assert_allclose(swing_leg.solve_legs(legs.J_BF_B, jnp.asarray(v, jnp.float32)), oracle, rtol=1e-4)


def test_a_foot_sent_too_far_to_the_side_keeps_its_height_at_the_hip_s_stop():
    state = robot(2)._replace(R_WB=jnp.eye(3), r_WB=jnp.zeros(3), v_WB=jnp.zeros(3), omega_B=jnp.zeros(3))
    legs = leg_kinematics(GEOMETRY, state.q)
    hips, limits = np.asarray(GEOMETRY.r_BH_B), np.asarray(GEOMETRY.position_limits).reshape(4, 3, 2)
    pointed = GEOMETRY._replace(foot_radius=jnp.float32(0.0))
    for side in (-0.4, -0.05, 0.05, 0.4):
        target = hips + np.array([0.03, side, -0.4])
        motion = swing_leg.FootMotion(jnp.asarray(target, jnp.float32), jnp.zeros((4, 3)))
        command = swing_leg.joint_positions(params(), pointed, state, legs, motion, jnp.asarray([0.0, 0.0, 1.0]))
        reached = np.asarray(leg_kinematics(GEOMETRY, command).r_BF_B)
        np.testing.assert_allclose(reached[:, [0, 2]], target[:, [0, 2]], atol=1e-5)
        angle = np.clip(np.arctan2(side, 0.4), limits[:, 0, 0], limits[:, 0, 1])
        np.testing.assert_allclose(reached[:, 1], hips[:, 1] + 0.4 * np.tan(angle), atol=1e-5)


def test_a_hip_stays_at_its_stop_until_a_target_beyond_it_is_due_back():
    """Led from the stop instead of from the target, hips came back early: feet landed short of where a push led."""
    state = robot(2)._replace(R_WB=jnp.eye(3), r_WB=jnp.zeros(3), v_WB=jnp.zeros(3), omega_B=jnp.zeros(3))
    legs = leg_kinematics(GEOMETRY, state.q)
    hips, stops = np.asarray(GEOMETRY.r_BH_B), np.asarray(GEOMETRY.position_limits).reshape(4, 3, 2)[:, 0]
    for side, stop in ((1.0, stops[:, 1]), (-1.0, stops[:, 0])):
        target = jnp.asarray(hips + np.array([0.03, side * 0.4, -0.4]), jnp.float32)
        coming_back = swing_leg.FootMotion(target, jnp.broadcast_to(jnp.array([0.0, -side, 0.0]), (4, 3)))
        for lead, due in ((0.05, False), (0.3, True)):
            p = params(position_lead=[lead] * 3)
            command = swing_leg.joint_positions(p, GEOMETRY, state, legs, coming_back, jnp.asarray([0.0, 0.0, 1.0]))
            away = np.abs(np.asarray(command).reshape(4, 3)[:, 0] - stop)
            assert (away > 0.05).all() if due else (away < 1e-6).all()


def test_commands_stay_within_the_joint_limits():
    state = robot(1)
    legs = leg_kinematics(GEOMETRY, state.q)
    far = swing_leg.FootMotion(jnp.full((4, 3), 3.0), jnp.full((4, 3), 50.0))
    p = params(position_lead=[0.08, 0.05, 0.02])
    command = swing_leg.joint_positions(p, GEOMETRY, state, legs, far, jnp.asarray([0.0, 0.0, 1.0]))
    limits = np.asarray(GEOMETRY.position_limits)
    assert np.all(command >= limits[:, 0]) and np.all(command <= limits[:, 1])
