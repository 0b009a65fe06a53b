"""What a report shows: the recorded signals of one motion, the course of a search, sensitivities."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from mjx_starleth.numbers import RobotNumbers

JUMP_PHASES: Final = ("crouch", "launch", "flight", "landing", "standing")

_SHAPES: Final = {
    "q": (19,),
    "u": (18,),
    "foot_position": (4, 3),
    "contact_force": (4, 3),
    "desired_height": (),
    "phase": (),
    "planned_stance": (4,),
    "command": (3,),
    "velocity": (3,),
    "estimated_velocity": (3,),
    "pitch": (),
    "desired_pitch": (),
}


@dataclass(frozen=True, eq=False)
class Recording:
    """Signals of one motion, T samples; SI, legs LF RF LH RH, joints leg-major.

    Raises ValueError for arrays of the wrong shape or values that are not finite.
    """

    drive: str  # full, cheap, ideal
    time: np.ndarray  # (T,) s, at the start of each control period
    q: np.ndarray  # (T, 19) torso x y z, quaternion w x y z torso to world, joint positions
    u: np.ndarray  # (T, 18) torso velocity (world), angular velocity (torso), joint velocities
    foot_position: np.ndarray  # (T, 4, 3) centres of the feet, world frame
    contact_force: np.ndarray  # (T, 4, 3) on the feet, world frame, N
    joint_torque: np.ndarray  # (T, 12) on the links, N m
    wanted_velocity: np.ndarray  # (T, 12) asked of the gears before limits, rad/s at the gear's output
    commanded_velocity: np.ndarray  # (T, 12) after speed and power limits
    motor_velocity: np.ndarray  # (T, 12) reached, at the gear's output
    current: np.ndarray  # (T, 12) largest size in the period, A
    voltage: np.ndarray  # (T, 12) largest size in the period, V

    def __post_init__(self) -> None:
        samples = np.shape(self.time)
        if len(samples) != 1 or samples[0] < 2:
            raise ValueError("a recording needs at least two samples in time.")
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name == "drive":
                continue
            array = np.asarray(value, np.int64 if f.name == "phase" else np.float64)
            expected = samples if f.name == "time" else samples + _SHAPES.get(f.name, (12,))
            if array.shape != expected:
                raise ValueError(f"{f.name} of a recording has the shape {array.shape}, not {expected}.")
            if f.name != "desired_height" and not np.isfinite(array).all():
                raise ValueError(f"{f.name} of a recording is not finite.")
            object.__setattr__(self, f.name, array)


@dataclass(frozen=True, eq=False)
class JumpRecord(Recording):
    """A recorded squat jump."""

    desired_height: np.ndarray  # (T,) of the torso, m; not shown in flight, may be NaN there
    phase: np.ndarray  # (T,) index into JUMP_PHASES

    @property
    def apex(self) -> float:
        """Largest height of the torso, m."""
        return float(self.q[:, 2].max())

    def start_of(self, phase: str) -> int | None:
        """Sample at which a phase begins; None if it never does."""
        samples = np.flatnonzero(self.phase == JUMP_PHASES.index(phase))
        return int(samples[0]) if len(samples) else None

    @property
    def take_off(self) -> int:
        """Sample at which the flight begins; the last one if it never does."""
        start = self.start_of("flight")
        return len(self.time) - 1 if start is None else start


@dataclass(frozen=True, eq=False)
class GaitRecord(Recording):
    """A recorded gait. Velocities along heading, to the left, and turning, in the plane of the ground."""

    desired_height: np.ndarray  # (T,) of the torso, m
    phase: np.ndarray  # (T,) strides begun so far, 0 while standing at the start
    planned_stance: np.ndarray  # (T, 4) 1 where the plan has the leg on the ground
    command: np.ndarray  # (T, 3) m/s, m/s, rad/s
    velocity: np.ndarray  # (T, 3) reached
    estimated_velocity: np.ndarray  # (T, 3) as the controller saw it
    pitch: np.ndarray  # (T,) of the torso against the level, nose down > 0, rad
    desired_pitch: np.ndarray  # (T,) rad


@dataclass(frozen=True, eq=False)
class History:
    """One entry per generation, G in all; stages count from 0 and never fall. Costs that are not finite become NaN."""

    best: np.ndarray  # (G,) cost of the generation's best
    mean: np.ndarray  # (G,) of the generation's costs
    stage: np.ndarray  # (G,) index into `stage_names`
    stage_names: Sequence[str]
    population: int
    std: np.ndarray | None = None  # (G,) of the generation's costs
    sigma: np.ndarray | None = None  # (G,) step size of the search, normalised

    def __post_init__(self) -> None:
        for name in ("best", "mean", "std"):
            if getattr(self, name) is not None:
                costs = np.asarray(getattr(self, name), np.float64)
                object.__setattr__(self, name, np.where(np.isfinite(costs), costs, np.nan))

    @property
    def best_so_far(self) -> np.ndarray:
        """(G,) lowest cost so far in the stage: stages score different problems."""
        return np.concatenate([np.fmin.accumulate(self.best[self.stage == s]) for s in np.unique(self.stage)])


@dataclass(frozen=True)
class Sensitivity:
    """How a metric changes when one number of the plant or the motion goes down and up."""

    name: str
    low: str  # what 'down' means: '-10 %'
    high: str
    change_low: float
    change_high: float


SATURATIONS: Final = ("speed", "power", "current", "voltage")
_AT_LIMIT: Final = 0.995  # of the limit: float32 and the loops' ripple keep a saturated signal from touching it


def saturations(record: Recording, numbers: RobotNumbers) -> Mapping[str, np.ndarray]:
    """Where each limit of the drive holds a joint back: name to (T, 12) of bool."""
    loops, drive = numbers.loops, numbers.drive
    wanted, commanded = np.abs(record.wanted_velocity), np.abs(record.commanded_velocity)
    clipped = commanded < _AT_LIMIT * wanted
    at_speed_limit = commanded >= _AT_LIMIT * loops.gear_speed_limit
    return {
        "speed": clipped & at_speed_limit,
        "power": clipped & ~at_speed_limit,
        "current": np.abs(record.current) >= _AT_LIMIT * drive.current_limit,
        "voltage": np.abs(record.voltage) >= _AT_LIMIT * drive.bus_voltage,
    }
