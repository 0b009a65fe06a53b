"""What a hidden effect is to the plant: parameters per log and joint, and the places where it cuts in.

One `Family` object carries an effect for a whole batch of logs: every parameter is a (B, 12) array (joint
effects) or (B,) (torso, feet), at its neutral value in the logs and joints that do not have the effect.
"""

from typing import Any, ClassVar

import numpy as np

from experiments.independent_plant.numbers import Array, joints_at


class Family:
    """A hidden effect: override `add` or the hooks that it needs; at neutral parameters it changes no bit.

    `torque` (B, 12), N m: the effect's own torque at the joints, kept current by the hooks and read once per
    control period. Its RMS over the RMS commanded torque is the effect's strength. Families that are no torque
    (a payload, the ground) leave it None and are measured otherwise, see strength.py.
    """

    name: ClassVar[str]
    about: ClassVar[str]
    units: ClassVar[dict[str, str]]  # parameter -> unit
    neutral: ClassVar[dict[str, float]] = {}  # parameter -> value without effect where it is not 0
    places: ClassVar[tuple[str, ...]] = ("joints",)  # "joints", "torso" or "feet"
    scaled: ClassVar[str]  # the parameter that makes the effect weak or strong, 0 for none
    library: ClassVar[bool] = True  # whether the diagnosis is meant to know it
    torque: Array | None = None

    def __init__(self, batch: int) -> None:
        for parameter in self.units:
            setattr(self, parameter, np.full((batch, 12), self.neutral.get(parameter, 0.0)))
        self.active = np.zeros((batch, 12))

    def add(self, log: int, where: str, parameters: dict[str, float], rng: np.random.Generator) -> None:
        """Put the effect into one log at a place. Raises ValueError for an unknown place or parameter."""
        joints = joints_at(where) > 0.0
        for parameter, value in self.checked(parameters).items():
            getattr(self, parameter)[log, joints] = value
        self.active[log, joints] = 1.0

    @classmethod
    def checked(cls, parameters: dict[str, float]) -> dict[str, float]:
        """The parameters, complete. Raises ValueError for one that the effect does not have."""
        unknown = set(parameters) - set(cls.units)
        if unknown:
            raise ValueError(f"{cls.name} has no parameter {sorted(unknown)}: it has {sorted(cls.units)}")
        return {key: float(parameters.get(key, cls.neutral.get(key, 0.0))) for key in cls.units}

    # In the drive, every 0.1 ms -----------------------------------------------------------------
    def attach(self, drive: Any) -> None:
        """Once, before the first step: change the drive's numbers."""
        raise NotImplementedError

    def friction(self, drive: Any, speed: Array, direction: Array) -> tuple[Array | float, Array | float]:
        """Rotor speed, rad/s, and its sign (at rest: the way it is pushed) -> what adds to the Coulomb level
        and to the smooth friction torque, N m."""
        raise NotImplementedError

    def rotor_torque(self, drive: Any, torque: Array) -> Array:
        """Motor torque at the rotor, N m, of the mean current over the step."""
        raise NotImplementedError

    def supply(self, drive: Any, voltage: Array) -> Array:
        """Voltage that the supply can give, V."""
        raise NotImplementedError

    def deflection(self, drive: Any, deflection: Array) -> Array:
        """Deflection that the spring sees, rad."""
        raise NotImplementedError

    def spring(self, drive: Any, torque: Array, deflection: Array, rate: Array) -> Array:
        """Spring torque on the link, N m."""
        raise NotImplementedError

    def commit(self, drive: Any) -> None:
        """End of a step: move the effect's own states on."""
        raise NotImplementedError

    # On the bodies ------------------------------------------------------------------------------
    def change_bodies(self, log: int, changes: Any) -> None:
        """Write the effect into the BodyChanges of one log."""
        raise NotImplementedError

    def link_torque(self, time: float, position: Array, velocity: Array) -> Array:
        """External torque on the joints, N m, every 0.1 ms."""
        raise NotImplementedError

    def observe(self, bodies: Any) -> None:
        """The Bodies every 2.5 ms: for effects that MuJoCo applies and that only keep `torque` here."""
        raise NotImplementedError

    def torso_force(self, time: float) -> Array:
        """External force on the torso's origin, world frame, (B, 3) N, every 2.5 ms."""
        raise NotImplementedError

    # On the signals, every 2.5 ms ---------------------------------------------------------------
    def command(self, time: float, command: Any) -> Any:
        """What reaches the joint controllers of a Command."""
        raise NotImplementedError

    def remember(self, time: float, signals: dict[str, Array]) -> None:
        """Every 0.5 ms: true signals, for sensors that look back in time."""
        raise NotImplementedError

    def measure(self, time: float, signals: dict[str, Array]) -> dict[str, Array]:
        """What the sensors make of the true signals."""
        raise NotImplementedError


def hooked(families: list[Family], point: str) -> list[Family]:
    """The families that cut in at a point."""
    return [family for family in families if getattr(type(family), point) is not getattr(Family, point)]
