"""Moreau's step against closed forms and MuJoCo C in small steps; with -s it prints errors and orders of convergence.

Locked joints make the robot one rigid body on four feet, for which sliding, slopes and impacts have closed forms.
"""

import mujoco
import numpy as np
import pytest
from body_scenarios import GRAVITY, MASS, bodies
from moreau_scenarios import (
    DURATION,
    LOCK,
    NOMINAL,
    STEP_SIZES,
    Motion,
    free_in_mujoco,
    in_mujoco,
    invariants,
    scenario,
    simulate_all,
    turned,
)

from mjx_starleth.terrain import plane, slope_normal

SLOPE, DOWNHILL = 0.35, 0.7  # rad
ALMOST = 0.02  # of the friction coefficient to either side of the friction angle
SLIDING_FRICTION, SLIDING_SPEED = 0.4, 0.6  # stops after 0.15 s
RESTITUTION, DROP_SPEED = 0.5, 1.0  # m/s
COMPLIANCE, GROUND_DAMPING = 4e-4, 60.0  # m/N and N s/m below each foot: 0.04 s to swing, a third of critical damping
STOP_SPEED = 8.0  # rad/s
SETTLED = 0.05  # s; the first steps start from no forces, and one rigid body needs several to find them
PRESSED = 1e-6  # m into the ground: closed from the first step on, whatever the rounding

WEIGHT_TOLERANCE = 0.1  # N of 263
ON_SLOPE = 1e-4  # of g: what is left is 0.7 % of g, the difference of two large parts
ROUNDING = 2e-5  # m and m/s, float32 over 400 steps of quantities of order one
ORDER = 0.8  # least order of convergence seen for a method of order one: between neighbouring steps it scatters


def on_slope(friction: float):
    normal = np.array(slope_normal(SLOPE, DOWNHILL))
    axis = np.array([-np.sin(DOWNHILL), np.cos(DOWNHILL), 0.0])
    rotation = np.zeros(4)
    mujoco.mju_axisAngle2Quat(rotation, axis, SLOPE)
    q = turned(lifted(-PRESSED), rotation)
    return scenario(q=q, damping=LOCK, friction=friction, terrain=plane(tuple(normal)))


def moving(**speeds) -> np.ndarray:
    u = np.zeros(18)
    for name, value in speeds.items():
        u["vx vy vz wx wy wz".split().index(name)] = value
    return u


def lifted(height: float) -> np.ndarray:
    """The default stance with its feet at a height, m."""
    q = np.array(bodies().initial_state(bodies().stance[7:]).q)
    q[2] += height
    return q


def vivid() -> np.ndarray:
    """A tumbling torso with swinging legs, within the joint stops for the duration."""
    u = moving(vx=0.3, vz=0.5, wx=4.0, wy=-5.0, wz=3.0)
    u[6:] = np.random.default_rng(0).uniform(-1.0, 1.0, 12)
    return u


def against_the_stop() -> np.ndarray:
    u = np.zeros(18)
    u[6 + 2] = STOP_SPEED  # LF_KFE, straightening: 1.165 rad from its stop
    return u


FREE = {"gravity": np.zeros(3), "joint_stop": np.tile([-10.0, 10.0], (12, 1))}
PUSH = [20.0, -30.0, 10.0, 4.0, -3.0, 5.0]
SCENARIOS = {
    "free fall": scenario(q=lifted(1.0), u=moving(vx=0.5, vz=1.0)),
    "rest": scenario(q=lifted(-PRESSED), damping=LOCK),
    "sliding": scenario(q=lifted(-PRESSED), u=moving(vx=SLIDING_SPEED), damping=LOCK, friction=SLIDING_FRICTION),
    "slope sticks": on_slope(np.tan(SLOPE) * (1 + ALMOST)),
    "slope slides": on_slope(np.tan(SLOPE) * (1 - ALMOST)),
    "impact": scenario(q=lifted(0.02), u=moving(vz=-DROP_SPEED), damping=LOCK),
    "rebound": scenario(q=lifted(0.02), u=moving(vz=-DROP_SPEED), damping=LOCK, restitution=RESTITUTION),
    "spinning": scenario(q=lifted(1.0), u=vivid(), **FREE),
    "end stop": scenario(q=lifted(1.0), u=against_the_stop(), gravity=np.zeros(3)),
    "wrench": scenario(q=lifted(1.0), torque=np.tile([0.1, 0.2, -0.1], 4), wrench_W=PUSH, **FREE),
    "soft": scenario(damping=LOCK, compliance=COMPLIANCE, ground_damping=GROUND_DAMPING),
    "landing": scenario(q=lifted(0.03), u=moving(vx=0.3, vz=-0.5), stiffness=100.0, damping=4.0),
}


@pytest.fixture(scope="module")
def motions() -> dict[str, list[Motion]]:
    return simulate_all(SCENARIOS)


def orders(name: str, errors: list[float]) -> np.ndarray:
    """log2 of the ratio of errors of neighbouring steps; printed."""
    errors = np.array(errors)
    found = np.log2(errors[:-1] / errors[1:])
    table = ", ".join(f"{1e3 * h:g} ms {e:.2e}" for h, e in zip(STEP_SIZES, errors, strict=True))
    print(f"\n{name}: {table}; order {np.round(found, 2)}")
    return found


def test_free_fall_is_exact_at_any_step(motions):
    s = SCENARIOS["free fall"]
    for motion in motions["free fall"]:
        t = motion.h * np.arange(1, len(motion.q) + 1)
        np.testing.assert_allclose(motion.q[:, 2], s.q[2] + t - GRAVITY * t**2 / 2, atol=ROUNDING)
        np.testing.assert_allclose(motion.q[:, 0], 0.5 * t, atol=ROUNDING)
        np.testing.assert_allclose(motion.q[:, 3:], s.q[None, 3:].repeat(len(t), 0), atol=ROUNDING)
        assert not motion.force.any()


def test_at_rest_the_ground_carries_the_weight(motions):
    for motion in motions["rest"]:
        late = slice(motion.at(SETTLED), None)
        np.testing.assert_allclose(motion.force[late, :, 2].sum(-1), MASS * GRAVITY, atol=WEIGHT_TOLERANCE)
        assert np.abs(motion.u[late]).max() < ROUNDING
        assert np.abs(motion.q[-1] - SCENARIOS["rest"].q).max() < ROUNDING


def test_a_soft_ground_swings_as_four_springs_with_dampers_do(motions):
    """z'' = -g - (4/m) (z / C + b z') from rest at z = 0."""
    square, decay = 4.0 / (MASS * COMPLIANCE), 2.0 * GROUND_DAMPING / MASS
    swing, sag, errors = np.sqrt(square - decay**2), GRAVITY / square, []
    for motion in motions["soft"]:
        t = motion.h * np.arange(1, len(motion.q) + 1)
        expected = sag * (np.exp(-decay * t) * (np.cos(swing * t) + decay / swing * np.sin(swing * t)) - 1.0)
        errors.append(np.abs(motion.q[:, 2] - SCENARIOS["soft"].q[2] - expected).max())
    assert (orders("soft ground, height, m", errors) > ORDER).all() and errors[NOMINAL] < 0.1 * sag


def test_sliding_decelerates_by_mu_g_and_stops(motions):
    deceleration, distances = SLIDING_FRICTION * GRAVITY, []
    stop = SLIDING_SPEED / deceleration
    for motion in motions["sliding"]:
        t = motion.h * np.arange(1, len(motion.u) + 1)
        slides = (t > SETTLED) & (t < stop - 3 * motion.h)  # the torso nods as the first feet stop
        acceleration = np.polyfit(t[slides], motion.u[slides, 0], 1)[0]
        np.testing.assert_allclose(acceleration, -deceleration, rtol=1e-4)
        assert np.abs(motion.u[t > stop + 2 * motion.h, 0]).max() < 10 * ROUNDING
        distances.append(motion.q[-1, 0])
    expected = SLIDING_SPEED**2 / (2 * deceleration)
    errors = np.abs(np.array(distances) - expected)
    orders("sliding, distance to the stop, m", errors)
    assert (errors < SLIDING_SPEED * STEP_SIZES / 2).all()  # the stop is dated to a step


def test_on_a_slope_it_sticks_below_and_slides_above_the_friction_angle(motions):
    down = np.array([np.cos(DOWNHILL) * np.cos(SLOPE), np.sin(DOWNHILL) * np.cos(SLOPE), -np.sin(SLOPE)])
    friction = np.tan(SLOPE) * (1 - ALMOST)
    expected = GRAVITY * (np.sin(SLOPE) - friction * np.cos(SLOPE))
    for sticks, slides in zip(motions["slope sticks"], motions["slope slides"], strict=True):
        start = sticks.at(SETTLED)
        assert np.linalg.norm(sticks.u[start:, :3], axis=1).max() < 10 * ROUNDING
        along = slides.u[start:, :3] @ down
        t = slides.h * np.arange(len(along))
        np.testing.assert_allclose(np.polyfit(t, along, 1)[0], expected, atol=GRAVITY * ON_SLOPE)
        across = slides.u[start:, :3] - along[:, None] * down
        assert np.abs(across).max() < 10 * ROUNDING


@pytest.mark.parametrize(("name", "restitution"), [("impact", 0.0), ("rebound", RESTITUTION)])
def test_impact_follows_newtons_law(motions, name, restitution):
    for motion in motions[name]:
        hit = int(np.flatnonzero(motion.force[:, :, 2].sum(1) > 0)[0])
        before, after = motion.u[hit - 1, 2], motion.u[hit, 2]
        assert before < -DROP_SPEED
        np.testing.assert_allclose(after, -restitution * before, atol=10 * ROUNDING)
        impulse = motion.force[hit].sum(0) * motion.h
        np.testing.assert_allclose(impulse[2], MASS * (after - before + GRAVITY * motion.h), rtol=1e-4)
        assert np.abs(impulse[:2]).max() < 1e-3 * impulse[2]


def test_spinning_torso_keeps_momentum_and_energy_to_the_first_order(motions):
    s = SCENARIOS["spinning"]
    momentum, energy = invariants(s.params, s.q, s.u)
    q, _ = free_in_mujoco(s)
    drift, position = [], []
    for motion in motions["spinning"]:
        after, left = invariants(s.params, motion.q[-1], motion.u[-1])
        drift.append((np.linalg.norm(after - momentum) / np.linalg.norm(momentum), abs(left / energy - 1)))
        position.append(np.abs(motion.q[-1] - q).max())
    lost = np.array(drift)
    assert (orders("spinning, angular momentum, relative", lost[:, 0]) > ORDER).all()
    orders("spinning, energy, relative", lost[:, 1])
    assert (orders("spinning, coordinates against MuJoCo C, rad or m", position) > ORDER).all()
    assert lost[NOMINAL].max() < 0.03


def test_wrench_and_torques_against_mujoco(motions):
    s = SCENARIOS["wrench"]
    q, _ = free_in_mujoco(s)
    errors = [np.abs(motion.q[-1] - q).max() for motion in motions["wrench"]]
    assert (orders("wrench, coordinates against MuJoCo C, rad or m", errors) > ORDER).all()
    assert errors[NOMINAL] < 0.01 * np.abs(q - s.q).max()


def test_end_stop_against_mujoco(motions):
    """The stop is met by a shank at 8 rad/s in between steps, and lasts 10 ms: coarse steps see it late and soft."""
    s, knee = SCENARIOS["end stop"], 9
    q, _ = in_mujoco(s, step=5e-5)
    fine = motions["end stop"][-1]
    errors = [np.abs(motion.q[-1] - q).max() for motion in motions["end stop"]]
    orders("end stop, coordinates against MuJoCo C after the rebound, rad or m", errors)
    assert errors[-1] < 5e-3 and (np.diff(errors) < 0).all()
    for motion in motions["end stop"]:
        late = motion.q[:, knee].max() - fine.q[:, knee].max()
        assert late < STOP_SPEED * motion.h
        assert -STOP_SPEED < motion.u[-1, knee] < 0.1  # it never pulls and never gains
    assert fine.q[:, knee].max() > s.params.joint_stop[2, 1]


@pytest.mark.slow
def test_landing_on_servo_legs_against_mujoco(motions):
    s = SCENARIOS["landing"]
    q, _ = in_mujoco(s, step=2e-5)
    errors = [np.abs(motion.q[-1] - q).max() for motion in motions["landing"]]
    orders("landing, coordinates against MuJoCo C, rad or m", errors)
    assert errors[NOMINAL] < 0.01 and errors[-1] < errors[0]


def test_contact_residuals_stay_small(motions):
    """Of four feet on legs; locked joints make one rigid body, whose forces are not unique and found more slowly."""
    for motion in motions["landing"]:
        assert motion.residual.max() < 0.1
    print("\nresidual, N:", {name: round(runs[NOMINAL].residual.max(), 4) for name, runs in motions.items()})


def test_duration_is_a_whole_number_of_steps():
    steps = DURATION / STEP_SIZES
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
