"""Kinematics and inverse dynamics of the legs in NumPy, for telling whether columns of a log belong together.

Plain second differences of positions and Newton's and Euler's laws link by link; not meant for simulation.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjx_starleth.names import FORE_SIGN, LEFT_SIGN, LEGS

Array = NDArray[np.float64]


class _Chain(NamedTuple):
    """One leg over time in the torso frame B: rotations, joint points and centres of mass of hip, thigh, shank."""

    rotations: list[Array]  # 3 of (T, 3, 3)
    joints: list[Array]  # 3 of (T, 3), HAA HFE KFE
    centres: list[Array]  # 3 of (T, 3)
    foot: Array  # (T, 3)


def foot_in_torso(leg: str, q: Array, numbers: Mapping[str, Any]) -> Array:
    """Centre of the foot r_BF (T, 3) in the torso frame, from the leg's joint positions `q` (T, 3)."""
    return _chain(leg, q, numbers).foot


def torques_in_air(leg: str, q: Array, period: float, numbers: Mapping[str, Any]) -> Array:
    """Joint torques (T, 3) that move a leg as `q` (T, 3) does, the torso level and at rest."""
    chain = _chain(leg, q, numbers)
    rates = np.gradient(q, period, axis=0)
    torque = np.zeros_like(q)
    axes = [np.broadcast_to([1.0, 0.0, 0.0], q.shape), chain.rotations[0][:, :, 1], chain.rotations[0][:, :, 1]]
    gravity = np.array([0.0, 0.0, numbers["gravity"]])
    for link, body in enumerate(("hip", "thigh", "shank")):
        omega = sum(axes[k] * rates[:, k : k + 1] for k in range(link + 1))
        R, inertia = chain.rotations[link], np.array(numbers["bodies"][body]["inertia_diagonal"])
        omega_link = (R * omega[:, :, None]).sum(1)
        spin = (R * (inertia * omega_link)[:, None, :]).sum(2)
        moment = np.gradient(spin, period, axis=0)  # d/dt (I omega), Euler
        velocity = np.gradient(chain.centres[link], period, axis=0)
        force = numbers["bodies"][body]["mass"] * (np.gradient(velocity, period, axis=0) + gravity)
        for k in range(link + 1):
            lever = chain.centres[link] - chain.joints[k]
            torque[:, k] += (axes[k] * (np.cross(lever, force) + moment)).sum(1)
    return torque


def rotation_WB(orientation: Array) -> Array:
    """Rotation matrices (T, 3, 3), torso to world, of quaternions w x y z (T, 4), normalised here."""
    w, x, y, z = (orientation / np.linalg.norm(orientation, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _chain(leg: str, q: Array, numbers: Mapping[str, Any]) -> _Chain:
    bodies = numbers["bodies"]
    place = LEGS.index(leg)
    at = bodies["haa_in_torso"]
    origin = np.array([FORE_SIGN[place] * at["x"], LEFT_SIGN[place] * at["y"], at["z"]])
    R_BH = _about_x(q[:, 0])
    rotations = [R_BH, R_BH @ _about_y(q[:, 1]), R_BH @ _about_y(q[:, 1] + q[:, 2])]
    lengths = (bodies["hip"]["length"], bodies["thigh"]["length"], bodies["foot"]["centre_from_knee"])
    joints = [np.broadcast_to(origin, q.shape)]
    centres = []
    for rotation, length, body in zip(rotations, lengths, ("hip", "thigh", "shank"), strict=True):
        centres.append(joints[-1] + rotation @ np.array(bodies[body]["com"]))
        joints.append(joints[-1] - length * rotation[:, :, 2])
    return _Chain(rotations, joints[:3], centres, joints[3])


def _about_x(angle: Array) -> Array:
    c, s, one, zero = np.cos(angle), np.sin(angle), np.ones_like(angle), np.zeros_like(angle)
    return np.moveaxis(np.array([[one, zero, zero], [zero, c, -s], [zero, s, c]]), 2, 0)


def _about_y(angle: Array) -> Array:
    c, s, one, zero = np.cos(angle), np.sin(angle), np.ones_like(angle), np.zeros_like(angle)
    return np.moveaxis(np.array([[c, zero, s], [zero, one, zero], [-s, zero, c]]), 2, 0)
