"""One experiment in memory: time, signals and what is known of the robot and its sensors. SI units, radians."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from mjx_starleth.names import JOINT_NAMES, LEGS


@dataclass(frozen=True)
class SignalKind:
    """What a signal of the log format is: the names it runs over (None: the robot's joints) and its SI unit."""

    names: tuple[str, ...] | None
    unit: str
    prismatic_unit: str | None = None  # where the joint slides
    commanded: bool = False


XYZ: Final = ("x", "y", "z")
SIGNALS: Final[Mapping[str, SignalKind]] = {
    "command_torque": SignalKind(None, "N m", "N", commanded=True),
    "command_position": SignalKind(None, "rad", "m", commanded=True),
    "joint_position": SignalKind(None, "rad", "m"),
    "joint_velocity": SignalKind(None, "rad/s", "m/s"),
    "motor_position": SignalKind(None, "rad", "m"),
    "motor_velocity": SignalKind(None, "rad/s", "m/s"),
    "joint_torque": SignalKind(None, "N m", "N"),
    "motor_current": SignalKind(None, "A", "A"),
    "applied_torque": SignalKind(None, "N m", "N"),
    "base_position": SignalKind(XYZ, "m"),
    "base_orientation": SignalKind(("w", "x", "y", "z"), "-"),
    "base_linear_velocity": SignalKind(XYZ, "m/s"),
    "base_angular_velocity": SignalKind(XYZ, "rad/s"),
    "base_acceleration": SignalKind(XYZ, "m/s^2"),
    "foot_contact": SignalKind(LEGS, "-"),
}


class BenchJoint(BaseModel):
    """Nominal numbers of a single joint on a bench: kg m^2 and N m s/rad, or kg and N s/m where it slides."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    name: str = Field(min_length=1, max_length=80, pattern=r"^[^/\s]+$")
    kind: Literal["revolute", "prismatic"] = "revolute"
    inertia: float = Field(gt=0)
    viscous_friction: float = Field(default=0.0, ge=0)
    gravity_load: float = 0.0  # N m at 90 degrees from hanging down
    drive: Literal["rigid", "HAA", "HFE", "KFE"] | None = None  # or the joint kind whose elastic drive turns it


def signal_names(signal: str, joint: BenchJoint | None) -> tuple[str, ...]:
    """The names that a signal runs over, on the robot or, with a `joint`, on the bench."""
    names = SIGNALS[signal].names
    if names is not None:
        return names
    return JOINT_NAMES if joint is None else (joint.name,)


def si_unit(signal: str, joint: BenchJoint | None) -> str:
    """The SI unit of a signal or of 'time'."""
    if signal == "time":
        return "s"
    kind = SIGNALS[signal]
    slides = joint is not None and joint.kind == "prismatic"
    return kind.prismatic_unit if slides and kind.prismatic_unit else kind.unit


@dataclass(frozen=True)
class SignalTable:
    """One signal: `values` (T, n), NaN for 'no value', one column for each of `names`."""

    names: tuple[str, ...]
    values: NDArray[np.float64]

    def column(self, name: str) -> NDArray[np.float64] | None:
        """The column (T,) of that name, None where it was not logged."""
        return self.values[:, self.names.index(name)] if name in self.names else None


@dataclass(frozen=True, eq=False)
class Log:
    """One experiment.

    `time` (T,) s; `signals` by name, absent where not logged; `noise_std` standard deviation per signal where the
    log's JSON gives it; `joint` the numbers of a joint on a bench, None for the robot; `unread` what the file holds
    that the format does not know (columns and JSON keys), for a hint where something is missing.
    """

    robot: Literal["starleth", "joint"]
    experiment: Literal["fixed_base", "ground", "bench"]
    sample_period: float
    noise_std: Mapping[str, float]
    joint: BenchJoint | None
    time: NDArray[np.float64]
    signals: Mapping[str, SignalTable]
    name: str = "log"
    source: str = ""
    unread: tuple[str, ...] = field(default=())

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The robot's joints in their fixed order, or the one joint on the bench."""
        return signal_names("joint_position", self.joint)

    @property
    def rows(self) -> int:
        return self.time.shape[0]

    def joints(self, signal: str) -> NDArray[np.float64] | None:
        """A joint signal (T, joints) in the order of `joint_names`, NaN where a joint lacks; None if not logged."""
        return self._ordered(signal, self.joint_names)

    def vector(self, signal: str) -> NDArray[np.float64] | None:
        """A base signal (T, 3 or 4) or the foot contacts (T, 4) in the format's order; None if not logged."""
        names = SIGNALS[signal].names
        if names is None:
            raise ValueError(f"'{signal}' is a joint signal: ask `joints` for it")
        return self._ordered(signal, names)

    def column(self, signal: str, name: str) -> NDArray[np.float64] | None:
        """One column (T,), None if not logged."""
        table = self.signals.get(signal)
        return None if table is None else table.column(name)

    def on_time(self, time: NDArray[np.float64], period: float, signals: Mapping[str, SignalTable]) -> "Log":
        """The same experiment on another time axis."""
        return replace(self, time=time, sample_period=period, signals=dict(signals))

    def _ordered(self, signal: str, names: tuple[str, ...]) -> NDArray[np.float64] | None:
        table = self.signals.get(signal)
        if table is None:
            return None
        if table.names == names:
            return table.values
        values = np.full((self.rows, len(names)), np.nan)
        for place, name in enumerate(names):
            column = table.column(name)
            if column is not None:
                values[:, place] = column
        return values
