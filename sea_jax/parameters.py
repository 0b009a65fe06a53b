"""The numbers of the drives as arrays, and the periods of their nested loops."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sea_jax.types import Array


@dataclass(frozen=True)
class LoopPeriods:
    """Periods of the nested loops, s. Static: they decide how long the scans are.

    Each must hold a whole number of the next; raises ValueError if it does not.
    """

    control: float = 2.5e-3
    velocity: float = 0.5e-3
    current: float = 0.1e-3

    def __post_init__(self) -> None:
        if not 0.0 < self.current <= self.velocity <= self.control:
            raise ValueError(f"loop periods must be positive and shrink inwards, got {self}")
        _whole_ratio("control", self.control, "velocity", self.velocity)
        _whole_ratio("velocity", self.velocity, "current", self.current)

    @property
    def velocity_steps(self) -> int:
        """Velocity-loop updates in one control period."""
        return round(self.control / self.velocity)

    @property
    def current_steps(self) -> int:
        """Current-loop updates in one velocity-loop period."""
        return round(self.velocity / self.current)


class DriveParams(NamedTuple):
    """Everything a search, a perturbation or a fit may change. Every field is (J,) float32, one a joint.

    Motor-side quantities are before the gear, spring and joint-controller quantities after it.
    """

    gear_ratio: Array
    torque_constant: Array  # N m/A
    back_emf_constant: Array  # V s/rad, motor side
    resistance: Array  # Ohm
    inductance: Array  # H
    motor_inertia: Array  # kg m^2, rotor with gear and bearings, motor side
    bus_voltage: Array  # V
    current_limit: Array  # A
    friction_coulomb: Array  # c0, N m, motor side
    friction_viscous: Array  # c1, N m s/rad, motor side
    friction_cubic: Array  # c2, N m s^3/rad^3, motor side
    bearing_friction: Array  # m: joint-side Coulomb torque per radial load
    spring_stiffness: Array  # N m/rad
    spring_damping: Array  # N m s/rad
    spring_side: Array  # +1 or -1: the sign of the torque the spring can carry; 0: both
    stop_stiffness: Array  # N m/rad, on the other side
    stop_damping: Array  # N m s/rad, on the other side
    velocity_kp: Array  # A s/rad, motor side
    velocity_ki: Array  # A/rad, motor side
    velocity_integral_limit: Array  # A
    current_kp: Array  # V/A
    current_ki: Array  # V/(A s)
    current_integral_limit: Array  # V
    torque_gain: Array  # rad/(s N m)
    velocity_feedforward: Array  # -
    position_a: Array  # 1/s, on the motor's error
    position_b: Array  # 1/s, on the joint's error
    position_c: Array  # -, on the joint's velocity
    speed_limit: Array  # rad/s
    power_limit: Array  # W
    ideal_stiffness: Array  # N m/rad, position mode of the ideal drive
    ideal_damping: Array  # N m s/rad
    torque_min: Array  # N m, of the ideal drive; -inf: no limit
    torque_max: Array  # N m, of the ideal drive; inf: no limit


# The authors' springless twin of the drive is a joint PD with these gains (FACTS 2.1).
IDEAL_PD = {"HAA": (70.0, 3.1), "HFE": (70.0, 3.2), "KFE": (26.0, 0.2)}


def params_from_numbers(numbers: Mapping) -> DriveParams:
    """Parameters of all drives, leg-major, from the robot's numbers: keys "legs", "joints", "drive", "loops".

    Raises ValueError that names a missing key.
    """
    with _missing_keys_named():
        return _params_from_numbers(numbers)


def periods_from_numbers(numbers: Mapping) -> LoopPeriods:
    """The loop periods of the robot's numbers, key "loops".

    Raises ValueError that names a missing key, or if the periods do not divide.
    """
    with _missing_keys_named():
        loops = numbers["loops"]
        return LoopPeriods(loops["control_period"], loops["velocity_period"], loops["current_period"])


@contextmanager
def _missing_keys_named() -> Iterator[None]:
    try:
        yield
    except KeyError as missing:
        raise ValueError(f"the robot's numbers lack the key {missing} that the drives need") from missing


def with_torque_limits(params: DriveParams, low: Array, high: Array) -> DriveParams:
    """The ideal drive clips its torque to low..high, (J,) N m; the real drives ignore this."""
    return params._replace(torque_min=jnp.asarray(low, jnp.float32), torque_max=jnp.asarray(high, jnp.float32))


def select_joints(params: DriveParams, indices: Sequence[int]) -> DriveParams:
    """The drives of some joints only, for example one on a bench."""
    return jax.tree.map(lambda field: field[np.asarray(indices)], params)


def _params_from_numbers(numbers: Mapping) -> DriveParams:
    drive, loops = numbers["drive"], numbers["loops"]
    legs, joints = numbers["legs"], numbers["joints"]
    count = len(legs) * len(joints)

    def everywhere(value: float) -> Array:
        return jnp.full(count, value, jnp.float32)

    def by_joint(values: Mapping) -> Array:
        return jnp.asarray([values[joint] for _ in legs for joint in joints], jnp.float32)

    velocity, current = loops["velocity_pi"], loops["current_pi"]
    torque_mode, position_mode = loops["torque_mode"], loops["position_mode"]
    return DriveParams(
        gear_ratio=everywhere(drive["gear_ratio"]),
        torque_constant=everywhere(drive["torque_constant"]),
        back_emf_constant=everywhere(drive["back_emf_constant"]),
        resistance=everywhere(drive["resistance"]),
        inductance=everywhere(drive["inductance"]),
        motor_inertia=everywhere(drive["motor_inertia"]),
        bus_voltage=everywhere(drive["bus_voltage"]),
        current_limit=everywhere(drive["current_limit"]),
        friction_coulomb=everywhere(drive["friction_coulomb"]),
        friction_viscous=everywhere(drive["friction_viscous"]),
        friction_cubic=everywhere(drive["friction_cubic"]),
        bearing_friction=everywhere(drive["bearing_friction_per_radial_load"]),
        spring_stiffness=by_joint(drive["spring_stiffness"]),
        spring_damping=by_joint(drive["spring_damping"]),
        spring_side=jnp.asarray([_knee_side(leg, joint, drive) for leg in legs for joint in joints], jnp.float32),
        stop_stiffness=everywhere(drive["knee_stop_stiffness"]),
        stop_damping=everywhere(drive["knee_stop_damping"]),
        velocity_kp=everywhere(velocity["kp"]),
        velocity_ki=everywhere(velocity["ki"]),
        velocity_integral_limit=everywhere(velocity["integrator_limit"]),
        current_kp=everywhere(current["kp"]),
        current_ki=everywhere(current["ki"]),
        current_integral_limit=everywhere(current["integrator_limit"]),
        torque_gain=by_joint(torque_mode["gain"]),
        velocity_feedforward=everywhere(torque_mode["velocity_feedforward"]),
        position_a=by_joint({joint: position_mode[joint]["a"] for joint in joints}),
        position_b=by_joint({joint: position_mode[joint]["b"] for joint in joints}),
        position_c=by_joint({joint: position_mode[joint]["c"] for joint in joints}),
        speed_limit=everywhere(loops["gear_speed_limit"]),
        power_limit=everywhere(loops["power_limit"]),
        ideal_stiffness=by_joint({joint: IDEAL_PD[joint][0] for joint in joints}),
        ideal_damping=by_joint({joint: IDEAL_PD[joint][1] for joint in joints}),
        torque_min=everywhere(-np.inf),
        torque_max=everywhere(np.inf),
    )


def _knee_side(leg: str, joint: str, drive: Mapping) -> float:
    """Fore knees carry positive torque, hind knees (mirrored, X configuration) negative torque."""
    if joint != "KFE" or not drive["knee_spring_one_sided"]:
        return 0.0
    return -1.0 if leg.endswith("H") else 1.0


def _whole_ratio(outer: str, long: float, inner: str, short: float) -> None:
    if abs(long / short - round(long / short)) > 1e-6:
        raise ValueError(f"the {outer} period {long} s must hold a whole number of {inner} periods of {short} s")
