"""Leg kinematics in NumPy: feet, Jacobians, weight of the links, rotations. Batch first; legs LF RF LH RH."""

import numpy as np

from experiments.independent_plant.numbers import FORE, LEFT, MIRROR, Array, numbers_file

_BODIES = numbers_file()["bodies"]
HIP, THIGH = _BODIES["hip"]["length"], _BODIES["thigh"]["length"]
SHANK = _BODIES["foot"]["centre_from_knee"]
FOOT_RADIUS = _BODIES["foot"]["radius"]
HAA_IN_TORSO = np.stack([FORE * _BODIES["haa_in_torso"]["x"], LEFT * _BODIES["haa_in_torso"]["y"], 0.0 * FORE], axis=-1)
LINK_MASS = np.array([_BODIES[link]["mass"] for link in ("hip", "thigh", "shank")])
LINK_COM = -np.array([_BODIES[link]["com"][2] for link in ("hip", "thigh", "shank")])
TOTAL_MASS = _BODIES["torso"]["mass"] + 4.0 * LINK_MASS.sum()
GRAVITY = numbers_file()["gravity"]


def point(angles: Array, hip: float, thigh: float, shank: float) -> tuple[Array, Array]:
    """A point hip, thigh and shank down the leg: in the torso frame (B, 4, 3) and its Jacobian (B, 4, 3, 3)."""
    a, b, c = np.moveaxis(angles.reshape(-1, 4, 3), -1, 0)
    x = -thigh * np.sin(b) - shank * np.sin(b + c)
    z = -hip - thigh * np.cos(b) - shank * np.cos(b + c)
    sin, cos, zero = np.sin(a), np.cos(a), np.zeros_like(a)
    position = HAA_IN_TORSO + np.stack([x, -sin * z, cos * z], axis=-1)
    knee_x, knee_z = -shank * np.cos(b + c), shank * np.sin(b + c)
    columns = [
        np.stack([zero, -cos * z, -sin * z], axis=-1),
        np.stack([z + hip, sin * x, -cos * x], axis=-1),
        np.stack([knee_x, -sin * knee_z, cos * knee_z], axis=-1),
    ]
    return position, np.stack(columns, axis=-1)


def feet(angles: Array) -> tuple[Array, Array]:
    """Centres of the feet in the torso frame and their Jacobians."""
    return point(angles, HIP, THIGH, SHANK)


def weight_torque(angles: Array, gravity_B: Array) -> Array:
    """Joint torques (B, 12) that hold the legs' links against gravity, (B, 3) in the torso frame."""
    torque = np.zeros((len(angles), 4, 3))
    lengths = [(LINK_COM[0], 0.0, 0.0), (HIP, LINK_COM[1], 0.0), (HIP, THIGH, LINK_COM[2])]
    for mass, length in zip(LINK_MASS, lengths):
        _, jacobian = point(angles, *length)
        torque -= mass * np.einsum("blij,bi->blj", jacobian, gravity_B)
    return torque.reshape(-1, 12)


def stance_angles(height: Array | float) -> Array:
    """Joint angles (..., 12) with the feet under the hips and the torso `height` m above flat ground."""
    reach = np.asarray(height, dtype=float) - HIP - FOOT_RADIUS
    knee = -np.arccos(np.clip((reach**2 - THIGH**2 - SHANK**2) / (2.0 * THIGH * SHANK), -1.0, 1.0))
    hip = np.arcsin(np.clip(SHANK * np.sin(-knee) / reach, -1.0, 1.0))
    leg = np.stack([np.zeros_like(knee), hip, knee], axis=-1)
    return MIRROR * np.tile(leg, 4)


def rotation(quaternion: Array) -> Array:
    """Unit quaternions (B, 4), w first -> rotation matrices (B, 3, 3)."""
    w, x, y, z = np.moveaxis(quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def roll_pitch_yaw(matrix: Array) -> Array:
    """Rotation matrices -> angles (B, 3) about x, then y, then z of the world, rad."""
    return np.stack(
        [
            np.arctan2(matrix[..., 2, 1], matrix[..., 2, 2]),
            -np.arcsin(np.clip(matrix[..., 2, 0], -1.0, 1.0)),
            np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0]),
        ],
        axis=-1,
    )
