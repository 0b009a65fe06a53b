"""The full drive against the oracle: matrix exponentials of the continuous equations under the sampled loops."""

import numpy as np
import pytest
from drive_scenarios import ROBOT, Scenario, chirp, play, seconds, sway
from reference_drive import ReferenceDrive, nominal

from sea_jax import LoopPeriods

# The drive's step is of first order: as if the current came half a current-loop period, 0.05 ms, too early. At the
# speed limit, 10 rad/s, this is 5e-4 rad, and saturations of integrators can leave some of it behind for good.
ANGLE = 2e-3
# The same through the hip's spring, 70 N m/rad, where motor and link do not follow each other.
TORQUE = 0.12
# A first-order error falls eightfold when the current loop and the step are eight times as fast; float32 and the
# oracle's own 1e-5 s / 8 leave less than this.
FALL = 5.0

T = 120
CONSTANT = np.ones(T)
SCENARIOS = {
    "torque step": Scenario("LF_HAA", torque=5 * CONSTANT),
    "torque chirp on a moving link": Scenario("LF_HFE", torque=chirp(T, 8, 1, 15), link=sway(T, 0.2, 6)),
    "knee within its spring": Scenario(
        "LF_KFE", torque=8 + 4 * np.sin(2 * np.pi * 3 * seconds(T)), link=sway(T, 0.15, 5)
    ),
    "knee on and off its stop": Scenario("LF_KFE", position=chirp(T, 0.1, 1, 4), link=sway(T, 0.1, 5)),
    "hind knee on and off its stop": Scenario("LH_KFE", position=-chirp(T, 0.1, 1, 4), link=-sway(T, 0.1, 5)),
    "position step": Scenario("RF_HFE", position=0.3 * CONSTANT, link=sway(T, 0.1, 4)),
    "current limit": Scenario("LF_HAA", torque=chirp(T, 12, 4, 12), changes={"I_max": 5.0}),
    "voltage limit": Scenario("LF_HAA", position=1.5 * CONSTANT, link=sway(T, 0.8, 1), changes={"bus": 18.0}),
    "speed limit": Scenario("LF_KFE", position=1.2 * CONSTANT, link=sway(T, 0.6, 1)),
    "power limit": Scenario("LF_HAA", torque=chirp(T, 15, 1, 5), changes={"power": 20.0}),
    "stick and slip": Scenario("LF_HFE", torque=chirp(T, 6, 1, 4), changes={"c0": 0.1}),
}


def reference(scenario: Scenario, **periods: float) -> dict[str, np.ndarray]:
    leg, joint = scenario.joint.split("_")
    drive = ReferenceDrive(nominal(ROBOT, joint, leg) | scenario.changes, **periods)
    motion = scenario.motion()
    return drive.run(scenario.commands(), motion, theta=motion[0, 0])


def errors(scenario: Scenario, **periods: float) -> dict[str, float]:
    found, expected = play(scenario, periods=LoopPeriods(**periods)), reference(scenario, **periods)
    return {name: float(np.abs(found[name] - expected[name]).max()) for name in expected}


@pytest.mark.parametrize("name", SCENARIOS)
def test_agrees_with_the_continuous_equations(name):
    error = errors(SCENARIOS[name])
    assert error["theta"] < ANGLE
    assert error["torque"] < TORQUE


@pytest.mark.parametrize("name", ["power limit", "knee on and off its stop"])
def test_converges_to_the_continuous_equations(name):
    coarse, fine = errors(SCENARIOS[name], current=1e-4), errors(SCENARIOS[name], current=1e-4 / 8)
    for channel in coarse:
        assert fine[channel] < coarse[channel] / FALL, channel


@pytest.mark.parametrize(
    ("name", "output", "limit"),
    [
        ("current limit", "peak_current", 5.0),
        ("voltage limit", "peak_voltage", 18.0),
        ("speed limit", "commanded_velocity", 10.0),
    ],
)
def test_scenarios_reach_the_limit_that_they_are_named_after(name, output, limit):
    reached = np.abs(play(SCENARIOS[name])[output]).max()
    assert 0.98 * limit < reached < 1.02 * limit


def test_commanded_power_is_limited():
    found = play(SCENARIOS["power limit"])
    power = np.abs(found["commanded_velocity"] * found["torque"])
    assert 19.9 < power.max() < 20.1
    assert np.abs(found["wanted_velocity"] * found["torque"]).max() > 40.0


def test_sticks_where_the_oracle_sticks():
    scenario = SCENARIOS["stick and slip"]
    found, expected = play(scenario), reference(scenario)
    stuck = found["w"] == 0.0
    assert 5 < stuck.sum() < T - 5
    np.testing.assert_array_equal(stuck, expected["w"] == 0.0)
