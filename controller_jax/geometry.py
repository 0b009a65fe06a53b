"""The robot as its controller knows it, from the plain numbers of the robot file (FACTS 1)."""

from collections.abc import Mapping
from typing import Any, Final

import jax.numpy as jnp
import numpy as np

from controller_jax.types import LegGeometry

# Legs LF RF LH RH: fore +1, hind -1; left +1, right -1.
FORE_SIGN: Final = np.array([1.0, 1.0, -1.0, -1.0])
LEFT_SIGN: Final = np.array([1.0, -1.0, 1.0, -1.0])
# What a joint value of the left fore leg becomes on each leg: right legs mirror HAA, hind legs HFE and KFE.
MIRROR: Final = np.stack([LEFT_SIGN, FORE_SIGN, FORE_SIGN], 1).reshape(12)

JOINTS: Final = ("HAA", "HFE", "KFE")
POSITION_MARGIN: Final = 0.05  # rad taken off each end of the joint ranges (FACTS 1)


def geometry_from_numbers(numbers: Mapping[str, Any], position_margin: float = POSITION_MARGIN) -> LegGeometry:
    """Geometry, masses and limits of the four legs.

    numbers: the robot file as a dictionary. position_margin: rad taken off each end of the joint ranges.
    Raises ValueError if a number is missing or no finite number.
    """
    try:
        geometry = _geometry(numbers, position_margin)
    except (KeyError, IndexError, TypeError) as error:
        raise ValueError(f"The robot's numbers lack or misform {error}: compare them with starleth.json.") from None
    for name, value in zip(geometry._fields, geometry):
        if not np.all(np.isfinite(value)):
            raise ValueError(f"The robot's numbers give a {name} that is not finite: correct the robot file.")
    return LegGeometry(*(jnp.asarray(value, jnp.float32) for value in geometry))


def _geometry(numbers: Mapping[str, Any], position_margin: float) -> LegGeometry:
    bodies = numbers["bodies"]
    haa = bodies["haa_in_torso"]
    links = [bodies[name] for name in ("hip", "thigh", "shank")]
    position = np.array([numbers["joint_limits_LF"][joint] for joint in JOINTS], float)
    position += np.array([position_margin, -position_margin])
    torque = np.array([numbers["torque_limits_LF"][joint] for joint in JOINTS], float)
    return LegGeometry(
        r_BH_B=np.stack([haa["x"] * FORE_SIGN, haa["y"] * LEFT_SIGN, np.full(4, haa["z"])], 1),
        hip_length=np.float64(bodies["hip"]["length"]),
        thigh_length=np.float64(bodies["thigh"]["length"]),
        shank_length=np.float64(bodies["foot"]["centre_from_knee"]),
        foot_radius=np.float64(bodies["foot"]["radius"]),
        torso_mass=np.float64(bodies["torso"]["mass"]),
        torso_com_B=np.array(bodies["torso"]["com"], float),
        link_mass=np.array([link["mass"] for link in links], float),
        link_com=np.array([-link["com"][2] for link in links], float),
        knee_sign=-FORE_SIGN,
        position_limits=_on_all_legs(position),
        torque_limits=_on_all_legs(torque),
        gravity=np.float64(numbers["gravity"]),
    )


def _on_all_legs(limits_LF: np.ndarray) -> np.ndarray:
    """(3, 2) limits of the left fore leg -> (12, 2): a mirrored joint swaps and negates its ends."""
    mirrored = np.tile(limits_LF, (4, 1)) * MIRROR[:, None]
    return np.sort(mirrored, axis=1)
