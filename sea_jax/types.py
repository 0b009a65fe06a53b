"""What goes into and comes out of the drives. Every array is (J,), one entry a joint, SI;
on the robot J = 12, leg-major LF RF LH RH x HAA HFE KFE.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax

Array = jax.Array


class JointCommand(NamedTuple):
    """What the locomotion controller asks of the joints, held for one control period."""

    torque: Array  # N m, used where position_mode is 0
    position: Array  # rad, used where position_mode is 1
    position_mode: Array  # 0.0 or 1.0


class JointMeasurement(NamedTuple):
    """What the joint controllers see at the start of the control period, noise and faults included."""

    position: Array  # link side, rad
    velocity: Array  # link side, rad/s
    torque: Array  # spring torque on the link, N m
    motor_position: Array  # gear output side, rad


class JointMotion(NamedTuple):
    """True motion of the links during the control period."""

    position: Array  # at the start of the period, rad
    velocity: Array  # at the start of the period, rad/s
    acceleration: Array  # mean over the period, rad/s^2 (zeros: constant velocity)
    radial_load: Array  # force across the joint's bearing, N


class DriveState(NamedTuple):
    """What the scan carries."""

    motor_position: Array  # gear output side, rad
    motor_velocity: Array  # gear output side, rad/s
    current: Array  # A
    velocity_integral: Array  # integrator of the velocity PI, A
    current_integral: Array  # integrator of the current PI, V
    voltage: Array  # that was last applied to the winding, V
    memory: Any  # states of the hooks, {} without hooks


class DriveOutput(NamedTuple):
    """What one control period produced."""

    torque: Array  # mean spring torque on the link over the period, N m
    damping: Array  # -d torque / d joint velocity over the period, N m s/rad, >= 0: lets the bodies be implicit
    end_torque: Array  # spring torque at the end of the period, N m: what the torque sensor reads next
    wanted_velocity: Array  # before limits, gear output side, rad/s
    commanded_velocity: Array  # after speed and power limits, rad/s
    peak_current: Array  # largest |current| in the period, A
    peak_voltage: Array  # largest |voltage| in the period, V


Hook = Callable[[Any, Any, Any], tuple[Any, Any]]  # (value, signals, memory) -> (value, memory)


class DriveHooks(NamedTuple):
    """Functions spliced into the drive's equations, in order; each is closed over its own parameters.

    A hook takes (value, signals, memory) and returns (value, memory). `signals` is the NamedTuple `Signals`.
    Once a control period: command, measurement, commanded_velocity. Once a step of the motor (full drive: current-loop
    period), in this order: supply_voltage, deflection, spring, motor_torque, friction. Deflection and spring are called
    once more at the end of the period, for its end torque; that call's memory is not kept.
    """

    command: tuple[Hook, ...] = ()  # JointCommand -> JointCommand
    measurement: tuple[Hook, ...] = ()  # JointMeasurement -> JointMeasurement
    commanded_velocity: tuple[Hook, ...] = ()  # gear velocity after limits, rad/s
    supply_voltage: tuple[Hook, ...] = ()  # V
    motor_torque: tuple[Hook, ...] = ()  # N m at the rotor
    friction: tuple[Hook, ...] = ()  # Friction(coulomb level, smooth torque), N m at the rotor
    deflection: tuple[Hook, ...] = ()  # motor minus joint position, rad
    spring: tuple[Hook, ...] = ()  # spring torque, N m on the link


class Signals(NamedTuple):
    """What a hook may look at; zeros where a signal does not exist yet at the hook's point.

    From the spring on, `deflection` is what the deflection hooks left of it, `spring_torque` what the spring hooks
    made of it, and `current` is the one that acts in this step.
    """

    motor_position: Array  # gear output side, rad
    motor_velocity: Array  # gear output side, rad/s
    current: Array  # A
    winding_voltage: Array  # V, that was applied in the step before
    joint_position: Array  # rad
    joint_velocity: Array  # rad/s
    deflection: Array  # rad
    deflection_rate: Array  # rad/s
    spring_torque: Array  # N m
    radial_load: Array  # force across the joint's bearing, N
    period: Array  # s, the time step of the loop that calls the hook, scalar
