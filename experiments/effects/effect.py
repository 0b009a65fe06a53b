"""An effect: a name, where it can act, its parameters, and the one equation it changes.

An effect adds an equation to a hook of the plant. Its parameters reach the equation already spread over the
places where it acts: one value per joint, link or foot, with every strength zero elsewhere. So an equation
never sees a place, and with its strengths at zero it must return its value unchanged.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, get_args

Axis = Literal["joint", "link", "foot", "torso", "ground"]
ONE_PLACE = frozenset({"torso", "ground"})  # axes along which an effect's parameters are scalars
Part = Literal["drive", "bodies", "contact", "sensors"]
NAME = r"[\w.-]{1,80}"  # of an effect: it stands before the @ of a place, and in model files

# An equation gets, beside the value, what it may look at (sea_jax.Signals), as far as it exists at its hook; those that
# act once, `measured_motion`, the timings and `torso_force` get None. Replays of logs undo a `measurement`: one
# without memory has to be affine in the torque; one with memory they undo by its `replay_timing` alone.
HOOKS: Mapping[str, str] = MappingProxyType(
    {
        "drive_parameters": "DriveParams -> DriveParams, once",
        "body_parameters": "BodyParams -> BodyParams, once",
        "command": "JointCommand -> JointCommand, every control period",
        "measurement": "JointMeasurement -> JointMeasurement, affine in its torque, every control period",
        "measured_motion": "JointMotion as logged -> true JointMotion (the inverse of `measurement`), replay only",
        "replay_timing": "Timing -> Timing, how late sensors are (replaces the effect's `measurement`), replay only",
        "loop_timing": "Timing -> Timing, when within a row the drives' loops run, replay of drives only",
        "commanded_velocity": "gear velocity that the velocity loops get [rad/s], every control period",
        "supply_voltage": "bus voltage [V], every 0.1 ms",
        "motor_torque": "torque at the rotor [N m], every 0.1 ms",
        "friction": "Friction(coulomb, smooth) at the rotor [N m], every 0.1 ms",
        "deflection": "spring deflection [rad], every 0.1 ms",
        "spring": "spring torque on the link [N m], every 0.1 ms",
        "joint_drag": "drag torque on the link, opposing its motion [N m], every control period",
        "torso_force": "force on the torso in the world frame [N], every control period",
    }
)
# the only ones that carry an equation's memory from one period to the next
DRIVE_HOOKS = (
    "command",
    "measurement",
    "commanded_velocity",
    "supply_voltage",
    "motor_torque",
    "friction",
    "deflection",
    "spring",
)


@dataclass(frozen=True)
class Parameter:
    """One number of an effect: `role` strength is zero when the effect is off, shape has a meaning only with it.

    `start` is a plausible size, in `unit`: the scale on which the fit moves and the value it starts from.
    """

    name: str
    unit: str
    low: float
    high: float
    start: float
    role: Literal["strength", "shape"] = "strength"

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise ValueError(f"parameter '{self.name}': equations read it as p.<name>, so it must be a Python name")
        if not self.low <= self.start <= self.high:
            raise ValueError(f"parameter {self.name}: start {self.start} lies outside [{self.low}, {self.high}]")
        if self.role == "strength" and not self.low <= 0.0 <= self.high:
            raise ValueError(f"parameter {self.name}: a strength must be able to be zero")

    @property
    def off(self) -> float:
        """Value where the effect does not act."""
        return 0.0 if self.role == "strength" else self.start


@dataclass(frozen=True)
class Effect:
    """A physical effect that a model may have or lack.

    equations maps a hook (see HOOKS) to a function `(p, value, signals) -> value`, where `p.<name>` holds the
    effect's parameters. With `memory` > 0 it is `(p, value, signals, memory) -> (value, memory)` at DRIVE_HOOKS:
    there its memory is an array (places, memory) of its own that starts at zero; it is as above at other hooks, which
    keep none. `seeds` are further starts for the shape parameters, for effects whose error has several valleys; some
    logs bring starts of their own. A `sharp` effect (an edge, a strong bend) changes a replay in no way that is near
    proportional to its strength: it is tried at several of them. A `fine` one repeats within the motion of a joint, so
    that only time tells whether it is steady. Raises ValueError for what cannot be: an unknown hook, no strength, a
    memory that no hook keeps, and the like.
    """

    name: str
    about: str
    part: Part
    axis: Axis
    parameters: tuple[Parameter, ...]
    equations: Mapping[str, Callable[..., Any]] = field(hash=False)
    memory: int = 0
    seeds: tuple[Mapping[str, float], ...] = field(default=(), hash=False)
    sharp: bool = False
    fine: bool = False

    def __post_init__(self) -> None:
        if not re.fullmatch(NAME, self.name):
            raise ValueError(f"effect '{self.name}': a name has 1 to 80 letters, digits, _, - and dots")
        for what, value, known in (("part", self.part, get_args(Part)), ("axis", self.axis, get_args(Axis))):
            if value not in known:
                raise ValueError(f"effect {self.name}: no {what} '{value}'; use one of {', '.join(known)}")
        if not isinstance(self.parameters, tuple) or not all(isinstance(p, Parameter) for p in self.parameters):
            raise ValueError(f"effect {self.name}: parameters must be a tuple of Parameter (one alone: with a comma)")
        if len({p.name for p in self.parameters}) < len(self.parameters):
            raise ValueError(f"effect {self.name}: two parameters have the same name")
        unknown = set(self.equations) - set(HOOKS)
        if unknown:
            raise ValueError(f"effect {self.name}: no hook {sorted(unknown)}; the hooks are {', '.join(HOOKS)}")
        if self.memory and not set(self.equations) & set(DRIVE_HOOKS):
            raise ValueError(
                f"effect {self.name}: none of its hooks keeps a memory; leave memory away, or give an equation at "
                f"{', '.join(DRIVE_HOOKS)}"
            )
        if not any(parameter.role == "strength" for parameter in self.parameters):
            raise ValueError(f"effect {self.name}: needs a parameter that is zero when the effect is off")

    @property
    def strengths(self) -> tuple[Parameter, ...]:
        """The parameters that are all zero when the effect is off."""
        return tuple(p for p in self.parameters if p.role == "strength")
