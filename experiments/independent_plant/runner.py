"""From cases to recordings: the motions, and which cases may run side by side in one batch."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from experiments.independent_plant.bench import RIGID_PERIOD, elastic_bench, rigid_bench
from experiments.independent_plant.bench_bodies import LOADS, nominal_load
from experiments.independent_plant.library import Effect
from experiments.independent_plant.log_setup import LogSetup, hanging, standing
from experiments.independent_plant.numbers import KINDS, BodyNumbers
from experiments.independent_plant.plant import PERIOD, Recording, simulate
from experiments.independent_plant.sensors import SensorSettings
from experiments.independent_plant.stance import STAND, GroundController, air_controller, hop_course, squat_course

SETTLE = 0.5  # s on the ground before a log begins, for feet and drives to come to rest
# motion -> platform; the bench's motions go by the drive that turns it
PLATFORM = {
    "air": "fixed_base",
    "air_torque": "fixed_base",
    "squat": "ground",
    "hops": "ground",
    "bench_HAA": "bench",
    "bench_HFE": "bench",
    "bench_KFE": "bench",
    "bench_rigid": "bench_rigid",
}


@dataclass(frozen=True)
class Case:
    """One log to be made: motion and richness, hidden effects, own numbers, how it is measured."""

    motion: str = "air"
    richness: str = "rich"  # rich, poor (slow only); in the air and on the bench also fast
    effects: tuple[Effect, ...] = ()
    seed: int = 0
    duration: float = 8.0  # s
    sensors: SensorSettings = field(default_factory=SensorSettings)
    velocity_phase: int = 0
    off: dict[str, tuple[float, float, float]] = field(default_factory=dict)  # drive numbers, factor per kind
    bodies: BodyNumbers = field(default_factory=BodyNumbers)
    load_off: tuple[float, float, float] = (1.0, 1.0, 1.0)  # bench: inertia, viscous friction, gravity
    group: str = "single"  # none, single, pair or outsider: what the scorer expects

    @property
    def platform(self) -> str:
        """Which cases it can share a batch with. Raises ValueError for an unknown motion."""
        if self.motion not in PLATFORM:
            raise ValueError(f"no motion {self.motion!r}: there are {', '.join(PLATFORM)}")
        return PLATFORM[self.motion]

    @property
    def bench_drive(self) -> str | None:
        """On a bench, the joint kind whose drive turns it, or `rigid`; None on the robot."""
        drive = self.motion.removeprefix("bench_")
        return drive if drive in LOADS else None

    @property
    def column(self) -> int | None:
        """On a bench, the column of the recording that is the log."""
        drive = self.bench_drive
        return None if drive is None else KINDS.index(drive) if drive in KINDS else 0

    @property
    def period(self) -> float:
        """Of the log's rows, s."""
        return RIGID_PERIOD if self.platform == "bench_rigid" else PERIOD

    def setup(self) -> LogSetup:
        """What the plant needs to know."""
        return LogSetup(self.seed, self.effects, self.off, self.bodies, self.sensors, self.velocity_phase)


def record(cases: Sequence[Case]) -> Recording:
    """Run a batch. Raises ValueError unless all cases share the platform and the duration."""
    platform, duration = cases[0].platform, cases[0].duration
    if any((case.platform, case.duration) != (platform, duration) for case in cases):
        raise ValueError("the cases of a batch must share their platform and duration")
    setups = [case.setup() for case in cases]
    rngs = [np.random.default_rng([case.seed, 0]) for case in cases]
    richness = [case.richness for case in cases]
    if platform == "fixed_base":
        by_torque = [case.motion == "air_torque" for case in cases]
        controller = air_controller(duration, richness, by_torque, rngs)
        return simulate("fixed_base", setups, controller, hanging(controller.courses[:, 0]), duration)
    if platform == "ground":
        courses = [
            hop_course(duration, rng) if case.motion == "hops" else squat_course(duration, case.richness, rng)
            for case, rng in zip(cases, rngs)
        ]
        start = standing(setups, STAND)
        return simulate("ground", setups, GroundController(courses), start, duration, SETTLE)
    drives = [case.bench_drive or "" for case in cases]
    loads = [nominal_load(drive).off(case.load_off) for drive, case in zip(drives, cases)]
    if platform == "bench":
        return elastic_bench(setups, loads, drives, duration, richness)
    return rigid_bench(setups, loads, duration, richness)


def batches(cases: Sequence[Case], size: int) -> list[list[int]]:
    """Indices of cases that run together: one platform and duration, like effects next to each other."""

    def key(i: int) -> tuple:
        case = cases[i]
        return case.platform, case.duration, [effect.effect for effect in case.effects], i

    found: list[list[int]] = []
    for i in sorted(range(len(cases)), key=key):
        last = found[-1] if found else None
        alike = last is not None and key(last[0])[:2] == key(i)[:2] and len(last) < size
        if alike:
            last.append(i)
        else:
            found.append([i])
    return found
