"""What the joints of a leg owe each other: in the air to Newton, on the ground to a foot that stays put."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import numpy as np

from experiments.measurement.checks.leg_model import foot_in_torso, rotation_WB, torques_in_air
from experiments.measurement.checks.links import GAIN, Column, Columns, Link
from experiments.measurement.checks.matching import Array

XYZ: Final = ("x", "y", "z")
WXYZ: Final = ("w", "x", "y", "z")
_KINDS: Final = ("HAA", "HFE", "KFE")
_SWING: Final = 12.0  # Hz; above, twice differentiated positions are noise
_STANCE: Final = 20.0
_DYNAMICS_FLOOR: Final = 0.05
_STANCE_FLOOR: Final = 0.01
_LEAST_STANCE: Final = 0.3  # share of the log


def air_links(leg: str, there: Iterable[Column], period: float, numbers: Mapping[str, Any]) -> list[Link]:
    """With the torso clamped, the torque of each joint is what moves the leg as measured."""
    present = set(there)
    positions = tuple(("joint_position", f"{leg}_{kind}") for kind in _KINDS)
    if not set(positions) <= present:
        return []
    last: list[tuple[Array, Array]] = []  # positions and torques of the last call: the joints of a leg share them

    def torques(q: Array) -> Array:
        if not last or not np.array_equal(last[0][0], q):
            last[:] = [(q, torques_in_air(leg, q, period, numbers))]
        return last[0][1]

    links = []
    for place, kind in enumerate(_KINDS):
        torque = ("joint_torque", f"{leg}_{kind}")
        if torque in present:
            links.append(_dynamics(place, torque, positions, period, torques))
    return links


def ground_links(leg: str, there: Iterable[Column], period: float, numbers: Mapping[str, Any]) -> list[Link]:
    """While a foot is on the ground, the torso moves as the leg's joints and the torso's rotation say."""
    present = set(there)
    positions = tuple(("joint_position", f"{leg}_{kind}") for kind in _KINDS)
    velocity = tuple(("base_linear_velocity", axis) for axis in XYZ)
    orientation = tuple(("base_orientation", part) for part in WXYZ)
    contact = ("foot_contact", leg)
    if not {*positions, *velocity, *orientation} <= present:
        return []
    radius = numbers["bodies"]["foot"]["radius"]

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        q = _stack(columns, positions)
        R_WB = rotation_WB(_stack(columns, orientation))
        r_BF_W = np.einsum("tij,tj->ti", R_WB, foot_in_torso(leg, q, numbers))
        v_WB = _stack(columns, velocity)
        standing = _standing(columns.get(contact), len(q))[:, None]
        # the foot is a ball that rolls: its centre moves by the shank's pitch and roll times the radius
        pitch = np.gradient(_torso_pitch(R_WB) + q[:, 1] + q[:, 2], period)
        roll = np.gradient(_torso_roll(R_WB) + q[:, 0], period)
        rolling = radius * np.stack([pitch, -roll, np.zeros_like(roll)], axis=1)
        return v_WB * standing, [(rolling - np.gradient(r_BF_W, period, axis=0)) * standing]

    columns = (*velocity, *positions, *orientation)
    return [Link("stance", columns, parts, _STANCE, _STANCE_FLOOR, (GAIN,))]


def _dynamics(
    place: int, torque: Column, positions: tuple[Column, ...], period: float, torques: Callable[[Array], Array]
) -> Link:
    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        q = _stack(columns, positions)
        return columns[torque], [torques(q)[:, place], np.gradient(q[:, place], period)]

    # N m s/rad of drag either way: the knee's torque in the air is small against that of any bearing
    return Link("leg dynamics", (torque, *positions), parts, _SWING, _DYNAMICS_FLOOR, (GAIN, (-0.1, 0.3)))


def _standing(contact: Array | None, rows: int) -> Array:
    """1 where the foot is on the ground and has been for a moment, else 0."""
    if contact is None:
        return np.ones(rows)
    margin = 10
    down = (contact > 0.5).astype(float)
    kernel = np.ones(2 * margin + 1)
    standing = (np.convolve(down, kernel, "same") >= kernel.size - 0.5).astype(float)
    standing[:margin], standing[-margin:] = down[:margin], down[-margin:]
    return standing if standing.mean() >= _LEAST_STANCE else np.zeros(rows)


def _torso_pitch(R_WB: Array) -> Array:
    return np.arctan2(-R_WB[:, 2, 0], np.hypot(R_WB[:, 2, 1], R_WB[:, 2, 2]))


def _torso_roll(R_WB: Array) -> Array:
    return np.arctan2(R_WB[:, 2, 1], R_WB[:, 2, 2])


def _stack(columns: Columns, names: tuple[Column, ...]) -> Array:
    return np.stack([columns[name] for name in names], axis=1)
