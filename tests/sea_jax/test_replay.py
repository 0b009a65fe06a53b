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
    ReplayRows,
    Timing,
    Trajectory,
    full_drive,
    link_motion,
    measured_start,
    replay,
    select_joints,
    settled_start,
    smoothed_link_motion,
)

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
    signals = {column.split("/")[0] for column in head} - {"time"}
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
settled = jax.jit(lambda rows, start, angle: settled_start(PARAMS, DriveHooks(), rows, start, angle))


def replay_nominal(rows: ReplayRows, start: DriveState) -> Trajectory:
    return replayed(PARAMS, rows, start)


@pytest.mark.parametrize("name", ["air_reference", "squat_reference"])
def test_nominal_drive_explains_the_log_to_the_noise(name):
    log = read(name)
    rows = rows_of(log, smooth=False)
    for channel, joints in misfit(log, replay_nominal(rows, resting(log))).items():
        assert overall(joints) < RAW, channel


@pytest.mark.parametrize("name", ["air_reference", "squat_reference"])
def test_smooth_links_and_settled_start_leave_the_sensors_noise(name):
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


def test_joint_controllers_may_see_their_own_angle_two_rows_late():
    log, still = read("air_reference"), jnp.zeros(12)
    rows = jax.tree.map(lambda x: x[:80], rows_of(log, smooth=False))
    late = Timing(still, still, jnp.full(12, 2 * PERIOD))
    found = replay(PARAMS, DriveHooks(), rows, resting(log), timing=late)
    step = jax.jit(lambda state, row: full_drive(PARAMS, state, row)[0])
    state, angles = resting(log), [resting(log).motor_position]
    for t in range(79):
        command, measurement, motion = jax.tree.map(lambda x, t=t: x[t], tuple(rows))
        seen = measurement._replace(motor_position=angles[max(t - 2, 0)])
        state = step(state, (command, seen, motion))
        angles.append(state.motor_position)
    np.testing.assert_allclose(found.motor_position, np.stack(angles), atol=1e-6)
    prompt = replay_nominal(rows, resting(log)).motor_position
    assert np.abs(np.asarray(prompt) - np.asarray(found.motor_position)).max() > 1e-3
