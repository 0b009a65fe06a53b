"""The robot's numbers file: its schema, and reading it.

Every model here has exactly the keys of starleth.json; units are SI, angles radians. Where the values come from
and how sure they are stands under `sources` in that file.
"""

import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

Real = Annotated[float, Field(strict=True)]
Positive = Annotated[float, Field(strict=True, gt=0)]
NotNegative = Annotated[float, Field(strict=True, ge=0)]
Vector = tuple[Real, Real, Real]
Interval = tuple[Real, Real]

# No robot of this kind has a file near this size; it bounds the memory a damaged or hostile one can ask for.
MAX_FILE_BYTES = 1_000_000
MOST_PERIODS = 1000  # of an inner loop in one of the next outer; every one is simulated


class _Numbers(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class PerJoint(_Numbers):
    """One positive value for each of the three kinds of joint."""

    HAA: Positive
    HFE: Positive
    KFE: Positive


class JointIntervals(_Numbers):
    """Lower and upper bound for each joint of the left fore leg; the others mirror it."""

    HAA: Interval
    HFE: Interval
    KFE: Interval

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for joint in ("HAA", "HFE", "KFE"):
            low, high = getattr(self, joint)
            if not low < high:
                raise ValueError(f"the lower bound of {joint} ({low:g}) must be below its upper bound ({high:g})")
        return self


class RigidBody(_Numbers):
    """Mass [kg], principal inertia about the centre of mass along the body's axes [kg m^2], com [m]."""

    mass: Positive
    inertia_diagonal: tuple[Positive, Positive, Positive]
    com: Vector

    @model_validator(mode="after")
    def _triangle(self) -> Self:
        small, middle, large = sorted(self.inertia_diagonal)
        if small + middle < large * (1 - 1e-9):
            raise ValueError("no rigid body has this inertia: the largest moment exceeds the sum of the other two")
        return self


class Torso(RigidBody):
    """The trunk; `box` is the size of the block that it is drawn as, m."""

    box: tuple[Positive, Positive, Positive]


class Link(RigidBody):
    """A link of the leg; `length` is the distance to the next joint (or foot) along -z, m."""

    length: Positive


class HipPosition(_Numbers):
    """Distances of the HAA axes from the torso's origin, m; mirrored for hind and right legs."""

    x: Positive
    y: Positive
    z: Real


class Foot(_Numbers):
    """Spherical foot, m."""

    radius: Positive
    centre_from_knee: Positive


class BodyNumbers(_Numbers):
    torso: Torso
    hip: Link
    thigh: Link
    shank: Link
    haa_in_torso: HipPosition
    foot: Foot


class ContactNumbers(_Numbers):
    friction: NotNegative
    restitution: Annotated[float, Field(strict=True, ge=0, le=1)]
    contact_flag_force: NotNegative  # N, a foot counts as loaded from here


class LegPose(_Numbers):
    HAA: Real
    HFE: Real
    KFE: Real


class Stance(_Numbers):
    base_height: Positive
    LF: LegPose


class DriveNumbers(_Numbers):
    """Motor, gear and spring of one drive."""

    gear_ratio: Positive
    torque_constant: Positive
    back_emf_constant: Positive
    resistance: Positive
    inductance: Positive
    motor_inertia: Positive
    bus_voltage: Positive
    current_limit: Positive
    friction_coulomb: NotNegative
    friction_viscous: NotNegative
    friction_cubic: Real
    bearing_friction_per_radial_load: NotNegative
    spring_stiffness: PerJoint
    spring_damping: PerJoint
    knee_spring_one_sided: bool
    knee_stop_stiffness: Positive
    knee_stop_damping: NotNegative


class VelocityLoop(_Numbers):
    kp: Positive
    ki: NotNegative
    integrator_limit: Positive


class TorqueMode(_Numbers):
    gain: PerJoint
    velocity_feedforward: Real


class PositionLaw(_Numbers):
    a: Real
    b: Real
    c: Real


class PositionMode(_Numbers):
    HAA: PositionLaw
    HFE: PositionLaw
    KFE: PositionLaw


class LoopNumbers(_Numbers):
    control_period: Positive
    velocity_period: Positive
    current_period: Positive
    velocity_pi: VelocityLoop
    current_pi: VelocityLoop
    torque_mode: TorqueMode
    position_mode: PositionMode
    gear_speed_limit: Positive
    power_limit: Positive

    @model_validator(mode="after")
    def _nested_periods(self) -> Self:
        for inner, outer in (("current", "velocity"), ("velocity", "control")):
            ratio = getattr(self, f"{outer}_period") / getattr(self, f"{inner}_period")
            if not 1 - 1e-6 < ratio <= MOST_PERIODS or abs(ratio - round(ratio)) > 1e-6:
                most = f"of {inner}_period, at most {MOST_PERIODS}"
                raise ValueError(f"{outer}_period must be a whole number {most}, not {ratio:g} of them")
        return self


class RobotNumbers(_Numbers):
    """Everything that is known of the robot; the shape of starleth.json."""

    about: str = ""
    gravity: Positive
    legs: tuple[Literal["LF"], Literal["RF"], Literal["LH"], Literal["RH"]]
    joints: tuple[Literal["HAA"], Literal["HFE"], Literal["KFE"]]
    bodies: BodyNumbers
    joint_limits_LF: JointIntervals
    torque_limits_LF: JointIntervals
    contact: ContactNumbers
    default_stance: Stance
    drive: DriveNumbers
    loops: LoopNumbers
    sources: dict[str, str] = {}  # path of a value, or of what it is part of -> where it comes from; prose

    def __hash__(self) -> int:
        return hash(self.model_dump_json(exclude={"sources"}))


def load_numbers(path: str | Path | None = None) -> RobotNumbers:
    """Numbers of the robot from a JSON file, or the package's own StarlETH.

    Raises ValueError with one sentence if the file cannot be read or does not describe a robot.
    """
    source = Path(path) if path is not None else resources.files(__package__) / "starleth.json"
    try:
        if path is not None and source.stat().st_size > MAX_FILE_BYTES:
            raise ValueError(f"Robot file {source} is larger than {MAX_FILE_BYTES} bytes; it is no robot file.")
        text = source.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"Robot file {source} is not UTF-8 text.") from None
    except OSError as error:
        raise ValueError(f"Robot file {source} cannot be read: {error.strerror or error}.") from None
    try:
        data = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"Robot file {source} is not valid JSON: {error}.") from None
    return robot_numbers(data, f"Robot file {source}")


def robot_numbers(data: Mapping[str, Any], name: str = "The robot description") -> RobotNumbers:
    """Checked numbers from a mapping of the file's shape; ValueError names the first thing that is wrong."""
    try:
        return RobotNumbers.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the whole file"
        what = first["msg"].removeprefix("Value error, ")
        raise ValueError(f"{name} is not usable: {where}: {what}.") from None
