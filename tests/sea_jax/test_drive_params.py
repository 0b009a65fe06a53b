"""Parameters and periods from the robot's numbers, and what they refuse."""

import copy

import numpy as np
import pytest
from drive_scenarios import JOINT_NAMES, PARAMS, ROBOT

from sea_jax import LoopPeriods, params_from_numbers, periods_from_numbers, select_joints


def test_every_parameter_is_one_float32_a_joint():
    for name, values in PARAMS._asdict().items():
        assert values.shape == (12,), name
        assert values.dtype == np.float32, name


def test_numbers_land_at_their_joints():
    numbers = copy.deepcopy(ROBOT)
    numbers["drive"]["spring_stiffness"] = {"HAA": 1.0, "HFE": 2.0, "KFE": 3.0}
    numbers["loops"]["position_mode"]["HFE"]["b"] = -4.0
    params = params_from_numbers(numbers)
    np.testing.assert_array_equal(params.spring_stiffness, [1.0, 2.0, 3.0] * 4)
    np.testing.assert_array_equal(params.position_b[1::3], [-4.0] * 4)
    assert float(params.position_b[0]) != -4.0


def test_only_knees_are_one_sided_and_only_if_asked():
    sides = dict(zip(JOINT_NAMES, np.asarray(PARAMS.spring_side), strict=True))
    assert {name: side for name, side in sides.items() if side} == {
        "LF_KFE": 1.0,
        "RF_KFE": 1.0,
        "LH_KFE": -1.0,
        "RH_KFE": -1.0,
    }
    numbers = copy.deepcopy(ROBOT)
    numbers["drive"]["knee_spring_one_sided"] = False
    np.testing.assert_array_equal(params_from_numbers(numbers).spring_side, np.zeros(12))


def test_a_missing_number_is_named():
    numbers = copy.deepcopy(ROBOT)
    del numbers["drive"]["inductance"]
    with pytest.raises(ValueError, match="lack the key 'inductance'"):
        params_from_numbers(numbers)
    del numbers["loops"]["current_period"]
    with pytest.raises(ValueError, match="lack the key 'current_period'"):
        periods_from_numbers(numbers)


def test_periods_of_the_robot_nest():
    periods = periods_from_numbers(ROBOT)
    assert (periods.velocity_steps, periods.current_steps) == (5, 5)
    assert hash(periods) == hash(LoopPeriods())


@pytest.mark.parametrize(
    "periods",
    [
        {"velocity": 1e-3},
        {"current": 0.15e-3},
        {"current": 0.0},
        {"current": 1e-3},
        {"control": float("nan")},
    ],
)
def test_periods_that_do_not_nest_are_refused(periods):
    with pytest.raises(ValueError, match="period"):
        LoopPeriods(**periods)


def test_joints_can_be_taken_alone():
    one = select_joints(PARAMS, [JOINT_NAMES.index("LH_KFE")])
    assert one.spring_side.shape == (1,)
    assert float(one.spring_side[0]) == -1.0
