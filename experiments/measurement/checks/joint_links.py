"""What the columns of one joint owe each other: rates, spring, the joint controllers' law, the motor's balance."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy.signal import lfilter

from experiments.measurement.checks.links import GAIN, Column, Columns, Link
from experiments.measurement.checks.matching import Array
from experiments.measurement.logs.log import BenchJoint
from mjx_starleth.names import JOINT_NAMES, JOINT_SIGN

# Hz. Motion of the legs is below; sensor noise and the loops' chatter are above.
MOTION: Final = 20.0
# The control law is looked at to where the drive still follows: the joint controllers act on the sensors' noise,
# and the motor's answer to it is a fingerprint even of a joint at rest.
CONTROL: Final = 100.0
NOISE: Final = (40.0, 120.0)

# Misfits that good data leave (planted logs: rates 1e-6 in the air, 1e-5 in a jump; spring 0.05 for the knee in
# the air, where the torque is small; law 2e-4, in saturation 0.2; current 0.02)
RATE_FLOOR: Final = 5e-3
MODEL_FLOOR: Final = 0.02
TRANSMISSION_FLOOR: Final = 5e-3
# s: the inner loop follows the velocity it is asked for with this lag (the authors', FACTS 2.2)
DRIVE_LAG: Final = 1.55e-3
# samples: delays between a command and the answer are an effect ('command_delay') up to here
COMMAND_LAGS: Final = (-2.5, 8.5)
FOLLOWING: Final = (-2.5, 60.0)  # samples by which a controller may follow
ANY_SIGN: Final = (-np.inf, np.inf)
# The current jumps at each tick and has died away by the next row: a sampled acceleration current is too small
CURRENT_GAIN: Final = (0.25, 1.6)
DAMPING: Final = (-2.0, 60.0)  # times the nominal one, which is small against what a spring's coating may add
FRICTION: Final = (0.0, 10.0)  # friction may be many times the nominal one, but it does not push


def joint_links(joint: str, there: Iterable[Column], period: float, numbers: Mapping[str, Any]) -> list[Link]:
    """The links of one joint of the robot among the columns that are `there`."""
    present = {signal for signal, name in there if name == joint}
    law = _control_law(joint, present, period, numbers)
    links = [
        law,
        _rate(joint, "joint_position", "joint_velocity", period),
        _rate(joint, "motor_position", "motor_velocity", period),
        _spring(joint, period, numbers),
        _transmission(joint, numbers),
        _motor_balance(joint, present, period, numbers),
    ]
    if {"command_torque", "motor_velocity"} <= present and np.isclose(period, numbers["loops"]["control_period"]):
        links += [_fingerprint(law), _current_fingerprint(joint, law)]
    return [link for link in links if all(signal in present for signal, _ in link.columns)]


def bench_links(joint: BenchJoint, there: Iterable[Column], period: float) -> list[Link]:
    """The links of a single joint on a bench."""
    present = {signal for signal, _ in there}
    links = [
        _rate(joint.name, "joint_position", "joint_velocity", period),
        _rate(joint.name, "motor_position", "motor_velocity", period),
        _tracking(joint.name, "command_position", "joint_position"),
        _tracking(joint.name, "command_torque", "applied_torque"),
        _load_balance(joint, period),
    ]
    return [link for link in links if all(signal in present for signal, _ in link.columns)]


def _rate(joint: str, position: str, velocity: str, period: float) -> Link:
    """Mean velocity between two samples = difference of positions over the period."""
    p, v = (position, joint), (velocity, joint)

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        return 0.5 * (columns[v][1:] + columns[v][:-1]), [np.diff(columns[p]) / period]

    return Link("rate", (v, p), parts, MOTION, RATE_FLOOR)


def _spring(joint: str, period: float, numbers: Mapping[str, Any]) -> Link:
    """Torque = k(d) + d(d) of the deflection, one-sided at the knee (FACTS 2.3)."""
    tau, theta, q = (("joint_torque", joint), ("motor_position", joint), ("joint_position", joint))

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        deflection = columns[theta] - columns[q]
        stiffness, damping = _stiffness(joint, deflection, numbers)
        return columns[tau], [stiffness * deflection, damping * np.gradient(deflection, period)]

    # a delay and the spring's damping look alike, and damping is an effect
    return Link("spring", (tau, theta, q), parts, MOTION, MODEL_FLOOR, (GAIN, DAMPING))


def _transmission(joint: str, numbers: Mapping[str, Any]) -> Link:
    """Joint position = motor position less what the spring gives under the measured torque."""
    tau, theta, q = (("joint_torque", joint), ("motor_position", joint), ("joint_position", joint))

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        torque = columns[tau]
        stiffness, _ = _stiffness(joint, torque, numbers)
        # rates, for positions would give the slowest motion all the weight
        return np.diff(columns[q]), [np.diff(columns[theta]), -np.diff(torque / stiffness)]

    return Link("transmission", (q, theta, tau), parts, MOTION, TRANSMISSION_FLOOR, (GAIN, (0.4, 2.5)))


def _control_law(joint: str, present: set[str], period: float, numbers: Mapping[str, Any]) -> Link:
    """Motor velocity follows the velocity that the joint controller asks for (FACTS 2.1)."""
    q, theta, tau = ("joint_position", joint), ("motor_position", joint), ("joint_torque", joint)
    (qd, link_speed), (thetad, gear_speed) = (_speed(side, joint, present, period) for side in ("joint", "motor"))
    loops = numbers["loops"]
    kind = joint[-3:]
    position_mode = loops["position_mode"][kind]
    gain, feedforward = loops["torque_mode"]["gain"][kind], loops["torque_mode"]["velocity_feedforward"]
    limit = loops["gear_speed_limit"]
    commands = [(signal, joint) for signal in ("command_torque", "command_position") if signal in present]
    follow = np.exp(-period / DRIVE_LAG)

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        nothing = np.full_like(columns[q], np.nan)
        torque, position = (columns.get((signal, joint), nothing) for signal in ("command_torque", "command_position"))
        by_torque = gain * (torque - columns[tau]) + feedforward * link_speed(columns)
        by_position = (
            position_mode["a"] * (position - columns[theta])
            + position_mode["b"] * (position - columns[q])
            - position_mode["c"] * link_speed(columns)
        )
        wanted = np.nan_to_num(np.where(np.isnan(torque), by_position, by_torque))
        return gear_speed(columns), [_lagging(np.clip(wanted, -limit, limit), follow)]

    measured = (thetad, q, qd, theta, tau)
    if not commands:
        measured = (*measured, ("command_torque", joint))  # not there: no link
    high = CONTROL if {"joint_velocity", "motor_velocity"} <= present else MOTION
    return Link("control law", (*commands, *measured), parts, high, MODEL_FLOOR, lags=COMMAND_LAGS)


def _fingerprint(law: Link) -> Link:
    """The motor's answer to the noise in its own controller's sensors: tells joints apart that move alike."""

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        target, terms = law.parts(columns)
        return np.diff(target, 2), [np.diff(term, 2) for term in terms]

    return replace(law, name="fingerprint", parts=parts, low=NOISE[0], high=NOISE[1], still=COMMAND_LAGS)


def _current_fingerprint(joint: str, law: Link) -> Link:
    """The current that the velocity loop answers the same noise with: tells when the current and the torque were
    measured, of which slow motion says little.

    Between two rows the loop makes a current of the velocity that was asked for and of that at both rows.
    """
    current = ("motor_current", joint)

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        speed, (answer,) = law.parts(columns)
        before = np.concatenate([speed[:1], speed[:-1]])
        return np.diff(columns[current], 2), [np.diff(term, 2) for term in (answer, -speed, before)]

    columns = tuple(dict.fromkeys((current, *law.columns)))
    bounds = ((0.0, np.inf), ANY_SIGN, ANY_SIGN)
    return Link("current fingerprint", columns, parts, NOISE[1], MODEL_FLOOR, bounds, still=(0.0, 0.0), low=NOISE[0])


def _motor_balance(joint: str, present: set[str], period: float, numbers: Mapping[str, Any]) -> Link:
    """Motor torque = load over the gear + rotor's inertia + friction, all over the torque constant (FACTS 2.2)."""
    current, tau = ("motor_current", joint), ("joint_torque", joint)
    thetad, gear_speed = _speed("motor", joint, present, period)
    drive = numbers["drive"]
    gear, constant = drive["gear_ratio"], drive["torque_constant"]

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        omega = gear * gear_speed(columns)
        load = columns[tau] / gear + drive["motor_inertia"] * np.gradient(omega, period)
        coulomb = drive["friction_coulomb"] * np.tanh(omega / 5.0)
        viscous = drive["friction_viscous"] * omega
        return columns[current], [load / constant, coulomb / constant, viscous / constant]

    return Link("motor balance", (current, tau, thetad), parts, MOTION, MODEL_FLOOR, (CURRENT_GAIN, FRICTION, FRICTION))


def _tracking(joint: str, command: str, measured: str) -> Link:
    """A controller that follows its command at some distance."""
    asked, done = (command, joint), (measured, joint)

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        return columns[done], [np.nan_to_num(columns[asked])]

    return Link("tracking", (done, asked), parts, MOTION, 0.05, lags=FOLLOWING, still=FOLLOWING)


def _load_balance(joint: BenchJoint, period: float) -> Link:
    """Applied effort = inertia * acceleration + friction + a load that depends on the position."""
    effort, q = ("applied_torque", joint.name), ("joint_position", joint.name)

    def parts(columns: Columns) -> tuple[Array, list[Array]]:
        position = columns[q]
        velocity = np.gradient(position, period)
        motion = joint.inertia * np.gradient(velocity, period) + joint.viscous_friction * velocity
        still = 0.05 * np.abs(velocity).max()
        friction = np.std(columns[effort]) * np.tanh(velocity / still) if still > 0 else np.zeros_like(velocity)
        gravity = [np.sin(position), np.cos(position)] if joint.kind == "revolute" else []
        return columns[effort], [motion, friction, *gravity]

    bounds = (GAIN, FRICTION, *((ANY_SIGN, ANY_SIGN) if joint.kind == "revolute" else ()))
    return Link("load balance", (effort, q), parts, MOTION, 0.05, bounds)


def _speed(side: str, joint: str, present: set[str], period: float) -> tuple[Column, Callable[[Columns], Array]]:
    """The column that tells a side's velocity, and how: measured, or else the rate of its position."""
    velocity, position = (f"{side}_velocity", joint), (f"{side}_position", joint)
    if velocity[0] in present:
        return velocity, lambda columns: columns[velocity]
    return position, lambda columns: np.gradient(columns[position], period)


def _stiffness(joint: str, loaded: Array, numbers: Mapping[str, Any]) -> tuple[Array | float, Array | float]:
    """Stiffness and damping at each sample; `loaded` has the sign of the spring's torque."""
    drive = numbers["drive"]
    stiffness, damping = drive["spring_stiffness"][joint[-3:]], drive["spring_damping"][joint[-3:]]
    if joint[-3:] != "KFE" or not drive["knee_spring_one_sided"]:
        return stiffness, damping
    # the knee's spring pushes one way only: +1 for fore, -1 for hind legs; the other way is the stop
    on_stop = loaded * JOINT_SIGN[JOINT_NAMES.index(joint)] < 0
    return (
        np.where(on_stop, drive["knee_stop_stiffness"], stiffness),
        np.where(on_stop, drive["knee_stop_damping"], damping),
    )


def _lagging(wanted: Array, follow: float) -> Array:
    """First-order lag of a value that is held from each row to the next."""
    return lfilter([0.0, 1.0 - follow], [1.0, -follow], wanted)
