"""What the torso's sensors owe each other: motion capture, gyroscope and accelerometer see one rigid body."""

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from experiments.measurement.checks.leg_links import WXYZ, XYZ
from experiments.measurement.checks.leg_model import rotation_WB
from experiments.measurement.checks.links import Column, Columns, Link
from experiments.measurement.checks.matching import Array

_MOTION: Final = 20.0  # Hz
_FLOOR: Final = 1e-2


def base_links(there: Iterable[Column], period: float, numbers: Mapping[str, Any]) -> list[Link]:
    """The links of the torso's sensors among the columns that are `there`, axis by axis."""
    present = set(there)
    links = []
    for axis, name in enumerate(XYZ):
        links += [_velocity(name, period), _gyroscope(axis, period), _accelerometer(axis, period, numbers["gravity"])]
    return [link for link in links if set(link.columns) <= present]


def _velocity(axis: str, period: float) -> Link:
    position, velocity = ("base_position", axis), ("base_linear_velocity", axis)

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        return 0.5 * (columns[velocity][1:] + columns[velocity][:-1]), [np.diff(columns[position]) / period]

    return Link("base rate", (velocity, position), parts, _MOTION, _FLOOR)


def _gyroscope(axis: int, period: float) -> Link:
    """omega_B from the change of the orientation."""
    rate = ("base_angular_velocity", XYZ[axis])
    orientation = tuple(("base_orientation", part) for part in WXYZ)

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        R_WB = _rotation(columns, orientation)
        turn = np.einsum("tji,tjk->tik", R_WB[:-1], R_WB[1:])  # ~ 1 + [omega_B x] period
        i, j = ((2, 1), (0, 2), (1, 0))[axis]
        omega = (turn[:, i, j] - turn[:, j, i]) / (2.0 * period)
        return 0.5 * (columns[rate][1:] + columns[rate][:-1]), [omega]

    return Link("gyroscope", (rate, *orientation), parts, _MOTION, _FLOOR)


def _accelerometer(axis: int, period: float, gravity: float) -> Link:
    """Specific force in the torso frame: R_WB' (dv/dt + g e_z)."""
    measured = ("base_acceleration", XYZ[axis])
    orientation = tuple(("base_orientation", part) for part in WXYZ)
    velocity = tuple(("base_linear_velocity", part) for part in XYZ)

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        v_WB = np.stack([columns[name] for name in velocity], axis=1)
        force_W = np.gradient(v_WB, period, axis=0) + np.array([0.0, 0.0, gravity])
        return columns[measured], [np.einsum("tj,tj->t", _rotation(columns, orientation)[:, :, axis], force_W)]

    # impacts are shorter than a sample: the acceleration at the row and the mean over it differ
    return Link("accelerometer", (measured, *orientation, *velocity), parts, _MOTION, 0.02)


def _rotation(columns: Columns, orientation: tuple[Column, ...]) -> Array:
    return rotation_WB(np.stack([columns[name] for name in orientation], axis=1))
