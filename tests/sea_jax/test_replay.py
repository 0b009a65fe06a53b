"""Replay of measurements from an independent simulator (MuJoCo C and a NumPy drive at 10 kHz, sensor noise added).

The first 1.5 s of two logs without hidden effects: legs in the air in position mode, squats on the ground in torque
mode. The nominal drive has to explain motor position, joint torque and motor current down to the noise.
"""

import csv
import gzip
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from drive_scenarios import JOINT_NAMES, PARAMS

from sea_jax import (
    DriveHooks,
    DriveState,
    JointCommand,
    JointMeasurement,
    JointMotion,
    LoopPeriods,
    ReplayRows,
    Timing,
    Trajectory,
    link_motion,
    measured_start,
    replay,
    select_joints,
    smoothed_link_motion,
)
from sea_jax.delay_line import LONGEST, delayed, earlier, later, motion_later
from sea_jax.full_drive import watched_drive
from sea_jax.spring import spring_torque

DATA = Path(__file__).parents[1] / "data"
PERIOD = 2.5e-3
NOISE = {"motor_position": 5e-5, "joint_torque": 0.05, "motor_current": 0.05}
ENCODER = {"position_noise": 2e-4, "velocity_noise": 0.02}

# RMS over noise. One is the sensors' own; the encoders' noise, through the spring, adds the rest.
RAW = 1.5
# The same with the encoders' noise smoothed and the first angle's noise taken out.
FINE = 1.15


def read(name: str) -> dict[str, np.ndarray]:
    """Columns of the log by signal, (T, 12), empty cells as NaN."""
    with gzip.open(DATA / f"{name}_1500ms.csv.gz", "rt") as file:
        head, *rows = csv.reader(file)
    table = np.array([[float(cell or "nan") for cell in row] for row in rows], np.float32)
    signals = {column.split("/")[0] for column in head if column.endswith("LF_HAA")}
    return {s: table[:, [head.index(f"{s}/{joint}") for joint in JOINT_NAMES]] for s in signals}


def rows_of(log: dict, smooth: bool) -> ReplayRows:
    measured = {name: jnp.asarray(values) for name, values in log.items()}
    position_mode = jnp.isnan(measured["command_torque"])
    command = JointCommand(
        jnp.nan_to_num(measured["command_torque"]),
        jnp.nan_to_num(measured["command_position"]),
        position_mode.astype(jnp.float32),
    )
    q, qd = measured["joint_position"], measured["joint_velocity"]
    motion = smoothed_link_motion(q, qd, PERIOD, **ENCODER) if smooth else link_motion(q, qd, PERIOD)
    measurement = JointMeasurement(q, qd, measured["joint_torque"], measured["motor_position"])
    return ReplayRows(command, measurement, motion)


def resting(log: dict) -> DriveState:
    """These logs begin with no current, even where the springs are loaded."""
    still = jnp.zeros(12)
    return measured_start(PARAMS, jnp.asarray(log["motor_position"][0]), still, still)


def misfit(log: dict, found: Trajectory) -> dict[str, np.ndarray]:
    """RMS of each joint over the noise, by channel."""
    return {
        channel: np.sqrt(np.mean((np.asarray(getattr(found, channel)) - log[channel]) ** 2, 0)) / noise
        for channel, noise in NOISE.items()
    }


def overall(joints: np.ndarray) -> float:
    return float(np.sqrt(np.mean(joints**2)))


replayed = jax.jit(lambda params, rows, start: replay(params, DriveHooks(), rows, start))


@jax.jit
def settled(rows: ReplayRows, start: DriveState, motor_position: jax.Array) -> DriveState:
    """`start` with the motor angle moved to fit the log's motor_position (T, J) by least squares."""

    def angle(shift: jax.Array) -> jax.Array:
        return replay_nominal(rows, start._replace(motor_position=start.motor_position + shift)).motor_position

    still = jnp.zeros_like(start.motor_position)
    replayed, slope = jax.jvp(angle, (still,), (jnp.ones_like(still),))
    shift = (slope * (motor_position - replayed)).sum(0) / (slope * slope).sum(0)
    return start._replace(motor_position=start.motor_position + shift)


def replay_nominal(rows: ReplayRows, start: DriveState) -> Trajectory:
    return replayed(PARAMS, rows, start)


@pytest.mark.parametrize("name", ["air_reference", "squat_reference"])
def test_nominal_drive_explains_the_log_to_the_noise(name):
    log = read(name)
    rows = rows_of(log, smooth=False)
    for channel, joints in misfit(log, replay_nominal(rows, resting(log))).items():
        assert overall(joints) < RAW, channel


@pytest.mark.parametrize("name", ["air_reference", "squat_reference"])
def test_smooth_links_and_a_settled_start_leave_the_sensors_noise(name):
    log = read(name)
    rows = rows_of(log, smooth=True)
    angle = jnp.asarray(log["motor_position"])
    start = settled(rows, resting(log), angle)
    for channel, joints in misfit(log, replay_nominal(rows, start)).items():
        assert overall(joints) < FINE, channel


def test_a_shift_of_one_row_is_seen():
    log = read("squat_reference")
    rows = rows_of(log, smooth=True)
    late = rows._replace(motion=jax.tree.map(lambda x: jnp.roll(x, 1, axis=0), rows.motion))
    assert overall(misfit(log, replay_nominal(late, resting(log)))["joint_torque"]) > 3.0


@pytest.mark.parametrize(
    ("field", "channel", "factor"),
    [
        ("friction_coulomb", "motor_current", 1.5),
        ("torque_constant", "motor_current", 0.9),
        ("spring_stiffness", "joint_torque", 1.1),
    ],
)
def test_a_wrong_parameter_is_seen(field, channel, factor):
    log = read("squat_reference")
    rows = rows_of(log, smooth=True)
    params = PARAMS._replace(**{field: factor * getattr(PARAMS, field)})
    found = replayed(params, rows, resting(log))
    right, wrong = misfit(log, replay_nominal(rows, resting(log)))[channel], misfit(log, found)[channel]
    assert overall(wrong) > 1.5 * overall(right)


def test_settling_takes_out_a_shifted_first_angle():
    log = read("squat_reference")
    rows = rows_of(log, smooth=True)
    start = resting(log)
    shifted = start._replace(motor_position=start.motor_position + 1e-3)
    angle = jnp.asarray(log["motor_position"])
    found, expected = settled(rows, shifted, angle), settled(rows, start, angle)
    # a quarter of the sensor's noise: what saturations of the loops make non-linear
    np.testing.assert_allclose(found.motor_position, expected.motor_position, atol=1.25e-5)


def test_gradients_of_the_misfit_point_at_a_wrong_friction():
    log = read("squat_reference")
    rows, start = rows_of(log, smooth=True), resting(log)
    current = jnp.asarray(log["motor_current"])

    def cost(scale):
        params = PARAMS._replace(friction_coulomb=scale * PARAMS.friction_coulomb)
        found = replay(params, DriveHooks(), rows, start)
        return jnp.mean(((found.motor_current - current) / NOISE["motor_current"]) ** 2)

    slope = jax.jit(lambda scale: jax.jvp(cost, (scale,), (jnp.float32(1.0),))[1])
    assert slope(jnp.float32(0.5)) < 0.0 < slope(jnp.float32(1.5))


def test_one_joint_alone_replays_like_among_twelve():
    log = read("air_reference")
    rows, start = rows_of(log, smooth=True), resting(log)
    joint = JOINT_NAMES.index("LH_KFE")
    one = jax.tree.map(lambda x: x[..., joint : joint + 1], (rows, start))
    alone = replayed(select_joints(PARAMS, [joint]), *one)
    among = replay_nominal(rows, start)
    for found, expected in zip(alone, among, strict=True):
        np.testing.assert_allclose(found[:, 0], expected[:, joint], rtol=1e-5, atol=1e-5)


def test_late_sensors_show_the_drive_s_own_past_to_a_part_of_a_row_to_the_log_and_to_its_controllers():
    """Against a loop by hand that keeps the state after 18 of a row's 25 steps and hands it on a row later."""
    log, still = read("air_reference"), jnp.zeros(12)
    rows = jax.tree.map(lambda x: x[:80], rows_of(log, smooth=False))
    age = jnp.full(12, PERIOD + 7e-4)
    found = replay(PARAMS, DriveHooks(), rows, resting(log), timing=Timing(still, still, still, age))

    def watch(kept, state, time):
        return jax.tree.map(lambda x, y: jnp.where(jnp.abs(time - 18e-4) < 1e-5, y, x), kept, _shown(state))

    @jax.jit
    def step(state, row):
        state, _, kept = watched_drive(PARAMS, state, row, DriveHooks(), LoopPeriods(), _shown(state), watch)
        return state, kept

    state, seen, torques = resting(log), [_shown(resting(log))], [found.joint_torque[0]]
    for t in range(79):
        command, measurement, motion = jax.tree.map(lambda x, t=t: x[t], tuple(rows))
        state, kept = step(state, (command, measurement._replace(motor_position=seen[max(t - 1, 0)][0]), motion))
        seen.append(kept)
        turned = 18e-4 * motion.acceleration
        link = motion.position + 18e-4 * (motion.velocity + 0.5 * turned)
        torques.append(spring_torque(PARAMS, kept[0] - link, kept[1] - motion.velocity - turned))
    late = [max(t - 1, 0) for t in range(80)]
    np.testing.assert_allclose(found.motor_position, np.stack([seen[t][0] for t in late]), atol=1e-6)
    np.testing.assert_allclose(found.motor_current, np.stack([seen[t][2] for t in late]), atol=1e-4)
    np.testing.assert_allclose(found.joint_torque, np.stack([torques[t] for t in late]), atol=1e-3)
    prompt = replay_nominal(rows, resting(log)).motor_position
    assert np.abs(np.asarray(prompt) - np.asarray(found.motor_position)).max() > 1e-3


def _shown(state: DriveState) -> tuple:
    return state.motor_position, state.motor_velocity, state.current


def test_motion_between_rows_is_that_of_a_turning_link():
    time, ages = PERIOD * jnp.arange(200.0)[:, None], jnp.array([0.0, 1.1e-3, 5e-3, 13.7e-3])
    w = 2 * np.pi * jnp.array([[0.5, 3.0, 4.0, 5.0]])

    def turning(t):
        return JointMotion(jnp.sin(w * t), w * jnp.cos(w * t), -w * w * jnp.sin(w * t), 0.0 * w * t)

    moved, expected = motion_later(turning(time), ages, PERIOD), turning(time + ages[None])
    # a chord is off by T^2/8 of the second derivative
    np.testing.assert_array_equal(moved.position[:, 0], turning(time).position[:, 0])
    for found, true, tolerance in zip(moved, expected, (3e-6, 0.025, 0.8, 0.0), strict=True):
        np.testing.assert_allclose(found[:190], true[:190], atol=tolerance)


def test_rows_before_and_after():
    rows = jnp.arange(40.0).reshape(20, 2) ** 2
    before, after = earlier(rows, jnp.array([0.0, 3.0])), later(rows, jnp.array([2.0, 0.5]))
    np.testing.assert_array_equal(before[:, 0], rows[:, 0])
    np.testing.assert_array_equal(before[:, 1], np.concatenate([np.repeat(rows[:1, 1], 3), rows[:-3, 1]]))
    np.testing.assert_array_equal(after[:, 0], np.concatenate([rows[2:, 0], np.repeat(rows[-1:, 0], 2)]))
    np.testing.assert_allclose(after[:-1, 1], 0.5 * (rows[:-1, 1] + rows[1:, 1]))


def test_beyond_the_longest_delay_the_oldest_row_stays():
    rows = jnp.repeat(1.0 + jnp.arange(40.0)[:, None], 2, 1)
    far, longest = jnp.array([LONGEST + 0.4, 20.0]), jnp.full(2, float(LONGEST))
    np.testing.assert_array_equal(delayed(rows[: LONGEST + 1].T, far), rows[LONGEST])
    np.testing.assert_array_equal(later(rows, far), later(rows, longest))
    np.testing.assert_array_equal(earlier(rows, jnp.ceil(far)), earlier(rows, longest))
    moved = motion_later(JointMotion(*(rows,) * 4), far * PERIOD, PERIOD)
    np.testing.assert_array_equal(moved.position[:-LONGEST], rows[LONGEST:])
    slope = jax.jacfwd(lambda periods: delayed(rows[: LONGEST + 1].T, periods))(jnp.zeros(2))
    np.testing.assert_array_equal(slope, jnp.eye(2))
