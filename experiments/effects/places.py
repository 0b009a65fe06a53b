"""Where an effect acts: place names, and the mask over joints, links or feet that each stands for."""

import numpy as np

from experiments.effects.effect import Axis
from mjx_starleth.names import JOINT_NAMES, JOINTS, LEGS


def places_of(axis: Axis, joint_names: tuple[str, ...] = JOINT_NAMES) -> tuple[str, ...]:
    """Every place name that an effect on this axis can have, widest first."""
    if axis == "torso":
        return ("torso",)
    if axis == "ground":  # known by the feet that stand on it
        return ("feet",)
    if axis == "foot":
        return ("feet", *LEGS)
    if joint_names == JOINT_NAMES:
        return ("all", *JOINTS, *LEGS, *JOINT_NAMES)
    return ("all", *joint_names) if len(joint_names) > 1 else joint_names


def mask(where: str, axis: Axis, joint_names: tuple[str, ...] = JOINT_NAMES) -> np.ndarray:
    """1.0 where the effect acts: (joints,) for joint and link, (4,) for foot, (1,) for torso and ground.

    Raises ValueError if the place does not exist on this axis.
    """
    if (axis, where) in (("torso", "torso"), ("torso", "all"), ("ground", "feet"), ("ground", "all")):
        return np.ones(1, np.float32)
    if axis == "foot" and where in ("feet", "all", *LEGS):
        return np.array([where in ("feet", "all", leg) for leg in LEGS], np.float32)
    if axis in ("joint", "link"):
        chosen = [where == "all" or where == name or where in name.split("_") for name in joint_names]
        if any(chosen):
            return np.array(chosen, np.float32)
    raise ValueError(
        f"no place '{where}' for an effect on the {axis}; use one of {', '.join(places_of(axis, joint_names))}"
    )
