"""The robot's nominal numbers, read from the numbers file as plain data, one value per log and joint.

Arrays are (B, 12), leg-major LF RF LH RH x HAA HFE KFE; SI. `B` is the number of logs simulated side by side.
"""

import importlib.util
import json
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray

LEGS = ("LF", "RF", "LH", "RH")
KINDS = ("HAA", "HFE", "KFE")
JOINT_NAMES = tuple(f"{leg}_{kind}" for leg in LEGS for kind in KINDS)
LINKS = ("hip", "thigh", "shank")
FORE = np.array([1.0, 1.0, -1.0, -1.0])
LEFT = np.array([1.0, -1.0, 1.0, -1.0])
# A number given for the left fore leg times this is the number of the other legs (X configuration).
MIRROR = np.stack([LEFT, FORE, FORE], axis=1).reshape(12)
IS_KNEE = np.array([kind == "KFE" for _ in LEGS for kind in KINDS])


@cache
def numbers_file() -> dict[str, Any]:
    """The numbers file; found without importing the package that carries it, which would import JAX."""
    spec = importlib.util.find_spec("mjx_starleth")
    if spec is None or not spec.submodule_search_locations:
        raise FileNotFoundError("the package mjx_starleth with starleth.json is not installed")
    return json.loads((Path(spec.submodule_search_locations[0]) / "starleth.json").read_text())


def per_kind(values: dict[str, float]) -> Array:
    """One number per joint kind -> (12,)."""
    return np.tile([values[kind] for kind in KINDS], 4)


def joints_at(where: str) -> Array:
    """The joints that a place names: `all`, a joint, a joint kind or a leg -> (12,) of 0.0 and 1.0.

    Raises ValueError for any other place.
    """
    if where == "all":
        return np.ones(12)
    chosen = [where in (name, *name.split("_")) for name in JOINT_NAMES]
    if not any(chosen):
        raise ValueError(f"no joint at {where!r}: use all, a joint, a joint kind or a leg")
    return np.array(chosen, dtype=float)


@dataclass
class DriveNumbers:
    """The drive train's numbers, (B, 12) each; the friction and inertia are at the rotor."""

    motor_inertia: Array  # kg m^2
    friction_coulomb: Array  # N m
    friction_viscous: Array  # N m s/rad
    friction_cubic: Array  # N m s^3/rad^3
    torque_constant: Array  # N m/A
    back_emf_constant: Array  # V s/rad
    resistance: Array  # Ohm
    inductance: Array  # H
    bus_voltage: Array  # V
    spring_stiffness: Array  # N m/rad
    spring_damping: Array  # N m s/rad
    stop_stiffness: Array  # N m/rad, where the knee's spring is not engaged
    stop_damping: Array  # N m s/rad
    bearing_radius: Array  # m, friction torque over radial load


# What a robot's own numbers may be off by, one factor per joint kind each.
UNCERTAIN = (
    "motor_inertia",
    "friction_coulomb",
    "friction_viscous",
    "torque_constant",
    "resistance",
    "spring_stiffness",
    "spring_damping",
    "bearing_radius",
)


def nominal_drive(batch: int) -> DriveNumbers:
    """The nominal drive train for every log of a batch."""
    drive = numbers_file()["drive"]
    stiffness, damping = per_kind(drive["spring_stiffness"]), per_kind(drive["spring_damping"])

    def full(value: float | Array) -> Array:
        return np.tile(np.broadcast_to(np.asarray(value, dtype=float), (12,)), (batch, 1))

    return DriveNumbers(
        **{
            name: full(drive[name])
            for name in (
                "motor_inertia",
                "friction_coulomb",
                "friction_viscous",
                "friction_cubic",
                "torque_constant",
                "back_emf_constant",
                "resistance",
                "inductance",
                "bus_voltage",
            )
        },
        spring_stiffness=full(stiffness),
        spring_damping=full(damping),
        stop_stiffness=full(np.where(IS_KNEE, drive["knee_stop_stiffness"], stiffness)),
        stop_damping=full(np.where(IS_KNEE, drive["knee_stop_damping"], damping)),
        bearing_radius=full(drive["bearing_friction_per_radial_load"]),
    )


@dataclass
class BodyNumbers:
    """The bodies' numbers of one log, as factors on the nominal ones."""

    torso_mass: float = 1.0
    link_mass: Array = field(default_factory=lambda: np.ones(3))  # hip, thigh, shank
    link_com: Array = field(default_factory=lambda: np.ones(3))
    ground_friction: float = 1.0
