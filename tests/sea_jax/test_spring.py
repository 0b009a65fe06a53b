"""The joint spring: linear at the hips, one-sided with its stop at the knees, mirrored on the hind legs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from drive_scenarios import JOINT_NAMES, PARAMS, ROBOT, Scenario, chirp, play, sway

from sea_jax import DRIVES, JointCommand, JointMeasurement, JointMotion, initial_state, select_joints
from sea_jax.spring import deflection_at, spring_torque

FLOAT32 = 1e-6
DRIVE = ROBOT["drive"]


def torque_of(joint: str, deflection: float, rate: float) -> float:
    everywhere = jnp.full(12, 1.0, jnp.float32)
    torque = spring_torque(PARAMS, deflection * everywhere, rate * everywhere)
    return float(torque[JOINT_NAMES.index(joint)])


@pytest.mark.parametrize("leg", ROBOT["legs"])
@pytest.mark.parametrize("deflection", [0.1, -0.1])
def test_hip_springs_are_linear(leg, deflection):
    expected = DRIVE["spring_stiffness"]["HFE"] * deflection + DRIVE["spring_damping"]["HFE"] * 2.0
    assert torque_of(f"{leg}_HFE", deflection, 2.0) == pytest.approx(expected, rel=FLOAT32)


@pytest.mark.parametrize(("leg", "sign"), [("LF", 1), ("RF", 1), ("LH", -1), ("RH", -1)])
def test_knee_springs_carry_one_sign_and_meet_their_stop_on_the_other(leg, sign):
    in_spring = DRIVE["spring_stiffness"]["KFE"] * 0.1 + DRIVE["spring_damping"]["KFE"] * 2.0
    on_stop = DRIVE["knee_stop_stiffness"] * -0.1 + DRIVE["knee_stop_damping"] * -2.0
    assert torque_of(f"{leg}_KFE", sign * 0.1, sign * 2.0) == pytest.approx(sign * in_spring, rel=FLOAT32)
    assert torque_of(f"{leg}_KFE", sign * -0.1, sign * -2.0) == pytest.approx(sign * on_stop, rel=FLOAT32)


def test_deflection_at_rest_carries_the_torque():
    torque = jnp.asarray([7.0, -7.0, 7.0] * 2 + [7.0, -7.0, -7.0] * 2, jnp.float32)
    for sign in (1.0, -1.0):
        deflection = deflection_at(PARAMS, sign * torque)
        found = spring_torque(PARAMS, deflection, jnp.zeros(12))
        np.testing.assert_allclose(found, sign * torque, rtol=FLOAT32)


def test_state_at_rest_holds_its_current_and_torque():
    torque = jnp.asarray([1.0, -2.0, 8.0] * 2 + [1.0, 2.0, -8.0] * 2, jnp.float32)
    state = initial_state(PARAMS, jnp.full(12, 0.3, jnp.float32), torque)
    carried = spring_torque(PARAMS, state.motor_position - 0.3, state.motor_velocity)
    np.testing.assert_allclose(carried, torque, rtol=1e-5)  # a difference of angles
    motor = state.current * PARAMS.torque_constant * PARAMS.gear_ratio
    np.testing.assert_allclose(motor, torque, rtol=FLOAT32)


@pytest.mark.parametrize(("joint", "mirror", "sign"), [("LF_KFE", "LH_KFE", -1), ("LF_KFE", "RF_KFE", 1)])
def test_hind_legs_are_mirror_images_of_fore_legs(joint, mirror, sign):
    told, link = chirp(80, 0.2, 1, 5), sway(80, 0.1, 5)
    one = play(Scenario(joint, position=told, link=link))
    other = play(Scenario(mirror, position=sign * told, link=sign * link))
    for name in ("theta", "w", "I", "torque", "mean_torque", "commanded_velocity"):
        np.testing.assert_array_equal(one[name], sign * other[name])
    np.testing.assert_array_equal(one["damping"], other["damping"])
    assert one["torque"].min() < -1.0 < 1.0 < one["torque"].max()  # both sides were visited


@pytest.mark.parametrize("link", [0.1, -0.1], ids=["on the stop", "in the spring"])
@pytest.mark.parametrize("drive", ["full", "cheap"])
def test_reported_damping_is_the_slope_of_the_torque_over_the_link_velocity(drive, link):
    held = select_joints(PARAMS, [2])._replace(friction_coulomb=jnp.full(1, 1e3, jnp.float32))
    zero = jnp.zeros(1, jnp.float32)
    state = initial_state(held, zero, zero)

    def mean_torque(speed):
        motion = JointMotion(zero + link, speed * jnp.ones(1), zero, zero)
        inputs = (JointCommand(zero, zero, zero), JointMeasurement(zero, zero, zero, zero), motion)
        output = DRIVES[drive](held, state, inputs)[1]
        return output.torque[0], output.damping[0]

    (_, damping), (slope, _) = jax.jvp(mean_torque, (jnp.float32(0.5),), (jnp.float32(1.0),))
    assert -float(slope) == pytest.approx(float(damping), rel=1e-4)  # float32 sums of 25
