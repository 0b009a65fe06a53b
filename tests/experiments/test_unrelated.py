"""A sensor that reads only noise is told from one that has nothing to read."""

import numpy as np
import pytest

from experiments.measurement.checks.links import Column, Columns, Link
from experiments.measurement.checks.unrelated import unrelated

PERIOD, NOISE = 0.0025, 0.05  # s, N m
TORQUE, MOTOR, JOINT = (("joint_torque", "LH_KFE"), ("motor_position", "LH_KFE"), ("joint_position", "LH_KFE"))


def link(name: str, target: Column, other: Column) -> Link:
    def parts(columns: Columns) -> tuple[np.ndarray, list[np.ndarray]]:
        return columns[target], [columns[other]]

    return Link(name, (target, other), parts, 20.0, 0.02)


@pytest.mark.parametrize(("asked", "wrong"), [(0.05, False), (0.2, False), (2.0, True)])
def test_a_torque_of_noise_alone_is_wrong_where_the_spring_asks_for_more(asked: float, wrong: bool) -> None:
    rng, time = np.random.default_rng(4), PERIOD * np.arange(3200)
    load = asked * NOISE * np.sqrt(2.0) * np.sin(2.0 * np.pi * time)
    columns = {TORQUE: NOISE * rng.standard_normal(len(time)), MOTOR: load, JOINT: load}
    links = [link("spring", TORQUE, MOTOR), link("leg dynamics", TORQUE, JOINT), link("transmission", MOTOR, JOINT)]
    matches = [one.match(columns, PERIOD) for one in links]
    assert list(unrelated(links, matches, columns, PERIOD)) == ([TORQUE] if wrong else [])


def test_another_quantity_is_wrong_where_the_spring_asks_for_nothing() -> None:
    time = PERIOD * np.arange(3200)
    load, other = 0.2 * NOISE * np.sin(2.0 * np.pi * time), np.sin(9.0 * np.pi * time)
    columns = {TORQUE: other, MOTOR: load, JOINT: load}
    links = [link("spring", TORQUE, MOTOR), link("leg dynamics", TORQUE, JOINT), link("transmission", MOTOR, JOINT)]
    matches = [one.match(columns, PERIOD) for one in links]
    assert list(unrelated(links, matches, columns, PERIOD)) == [TORQUE]
