"""The cheap drive against the full one, and the ideal drive against its definition."""

import jax.numpy as jnp
import numpy as np
import pytest
from drive_scenarios import PARAMS, Scenario, chirp, play, seconds, sway

from sea_jax import (
    DRIVES,
    DriveState,
    JointCommand,
    JointMeasurement,
    JointMotion,
    initial_state,
    with_torque_limits,
)

# The current loop that the cheap drive leaves out lags by 1 / (2 pi 1000 Hz) = 0.16 ms, and the cheap drive's step is
# 0.5 ms: at 10 rad/s a few mrad of motor angle, and a saturated integrator keeps some of it.
ANGLE = 8e-3
TORQUE = 0.03  # of the largest torque
T = 120
ZERO = jnp.zeros(12)


@pytest.mark.parametrize(
    "scenario",
    [
        Scenario("LF_HFE", torque=chirp(T, 8, 1, 8), link=sway(T, 0.2, 4)),
        Scenario("LH_KFE", torque=-6 * (1 - np.cos(20 * seconds(T))), link=sway(T, 0.1, 3)),
        Scenario("RF_HAA", position=chirp(T, 0.3, 1, 3), link=sway(T, 0.1, 3)),
        Scenario("LF_HAA", torque=chirp(T, 15, 2, 8), changes={"bus": 20.0}),
    ],
    ids=["hip torque", "knee torque", "position", "low voltage"],
)
def test_cheap_drive_is_close_to_the_full_one(scenario):
    cheap, full = play(scenario, "cheap"), play(scenario, "full")
    assert np.abs(cheap["theta"] - full["theta"]).max() < ANGLE
    assert np.abs(cheap["torque"] - full["torque"]).max() < TORQUE * np.abs(full["torque"]).max()


def test_cheap_drive_keeps_voltage_and_current_limits():
    found = play(Scenario("LF_HAA", torque=chirp(T, 15, 2, 8), changes={"bus": 20.0}), "cheap")
    assert found["peak_voltage"].max() == pytest.approx(20.0, rel=1e-5)
    found = play(Scenario("LF_HAA", torque=chirp(T, 15, 2, 8), changes={"I_max": 4.0}), "cheap")
    assert found["peak_current"].max() == pytest.approx(4.0, rel=1e-5)


def ideal(command, motion, params=PARAMS, measured=None):
    measured = motion if measured is None else measured
    measurement = JointMeasurement(measured.position, measured.velocity, ZERO, measured.position)
    state = DriveState(motion.position, motion.velocity, ZERO, ZERO, ZERO, ZERO, {})
    return DRIVES["ideal"](params, state, (command, measurement, motion))


def test_ideal_drive_gives_the_torque_that_it_is_told():
    torque = jnp.linspace(-40.0, 40.0, 12)
    motion = JointMotion(ZERO + 0.2, ZERO + 3.0, ZERO + 50.0, ZERO)
    _, output = ideal(JointCommand(torque, ZERO, ZERO), motion)
    np.testing.assert_array_equal(output.torque, torque)
    np.testing.assert_array_equal(output.end_torque, torque)
    np.testing.assert_array_equal(output.damping, ZERO)
    limited = with_torque_limits(PARAMS, ZERO - 20.0, ZERO + 30.0)
    _, output = ideal(JointCommand(torque, ZERO, ZERO), motion, limited)
    np.testing.assert_array_equal(output.torque, np.clip(torque, -20.0, 30.0))


def test_ideal_position_mode_is_the_mean_of_a_joint_pd_over_the_period():
    q, qd, qdd, wanted = 0.2, 3.0, -400.0, 0.5
    motion = JointMotion(ZERO + q, ZERO + qd, ZERO + qdd, ZERO)
    _, output = ideal(JointCommand(ZERO, ZERO + wanted, ZERO + 1.0), motion)
    t = (np.arange(1000) + 0.5) * 2.5e-3 / 1000
    for joint, (k, d) in enumerate([(70.0, 3.1), (70.0, 3.2), (26.0, 0.2)] * 4):
        expected = np.mean(k * (wanted - q - qd * t - 0.5 * qdd * t**2) - d * (qd + qdd * t))
        assert output.torque[joint] == pytest.approx(expected, rel=1e-5)
        assert output.damping[joint] == pytest.approx(d + 0.5 * 2.5e-3 * k, rel=1e-5)


def test_ideal_position_mode_acts_on_what_was_measured():
    motion = JointMotion(ZERO + 0.2, ZERO, ZERO, ZERO)
    command = JointCommand(ZERO, ZERO + 0.5, ZERO + 1.0)
    _, true = ideal(command, motion)
    _, off = ideal(command, motion, measured=motion._replace(position=motion.position + 0.01))
    np.testing.assert_allclose(off.torque - true.torque, -0.01 * PARAMS.ideal_stiffness, rtol=1e-4)


@pytest.mark.parametrize("drive", DRIVES)
def test_all_drives_share_one_signature(drive):
    state = initial_state(PARAMS, ZERO, ZERO)
    command = JointCommand(ZERO + 2.0, ZERO, ZERO)
    motion = JointMotion(ZERO, ZERO, ZERO, ZERO)
    measurement = JointMeasurement(ZERO, ZERO, ZERO, ZERO)
    after, output = DRIVES[drive](PARAMS, state, (command, measurement, motion))
    assert type(after) is DriveState
    assert all(field.shape == (12,) and field.dtype == jnp.float32 for field in (*after[:-1], *output))
