"""The drive trains of many robots at once: cascaded loops, motor, stick-slip friction, spring; 0.1 ms steps.

Per step of 0.1 ms, from the fast end to the slow one:
  electronics  L dI/dt = V - R I - K_e w           exactly, for the voltage held over the step
  motor        J dw/dt = K I - friction - spring/N  Heun, with Coulomb friction as events: a motor that comes
               to rest is at rest exactly and stays so until the driving torque exceeds the Coulomb level
  spring       tau = c d + b dd/dt, d = motor - joint; a knee's spring pulls one way, then meets its stop
Angles, speeds and spring torques are those of the gear's output side; (B, 12) everywhere.
"""

from dataclasses import dataclass

import numpy as np

from experiments.independent_plant.hooks import Family, hooked
from experiments.independent_plant.numbers import (
    IS_KNEE,
    MIRROR,
    Array,
    DriveNumbers,
    numbers_file,
    per_kind,
)

STEP = 1e-4  # s
VELOCITY_STEPS = 5  # the velocity loop runs every 0.5 ms
CONTROL_STEPS = 25  # the joint controllers every 2.5 ms


def clamp(value: Array, bound: Array | float) -> Array:
    """Limited to +-bound; several times as fast as np.clip on small arrays."""
    return np.minimum(np.maximum(value, -bound), bound)


@dataclass
class Command:
    """What the joint controllers are asked for; `position` rules where it is not NaN."""

    torque: Array  # N m
    position: Array  # rad


@dataclass
class Measured:
    """What the joint controllers see."""

    position: Array  # link side, rad
    velocity: Array  # link side, rad/s
    torque: Array  # N m
    motor_position: Array  # gear output side, rad


class JointController:
    """The torque and position laws at 400 Hz, with the speed and power limits (authors' laws, FACTS 2.1)."""

    def __init__(self) -> None:
        loops = numbers_file()["loops"]
        self.torque_gain = per_kind(loops["torque_mode"]["gain"])
        self.feedforward = loops["torque_mode"]["velocity_feedforward"]
        self.a, self.b, self.c = (
            per_kind({kind: law[key] for kind, law in loops["position_mode"].items()}) for key in "abc"
        )
        self.speed_limit = loops["gear_speed_limit"]
        self.power_limit = loops["power_limit"]

    def __call__(self, command: Command, seen: Measured) -> Array:
        """Wanted speed at the gear's output, rad/s."""
        by_torque = self.torque_gain * (command.torque - seen.torque) + self.feedforward * seen.velocity
        by_position = (
            self.a * (command.position - seen.motor_position)
            + self.b * (command.position - seen.position)
            - self.c * seen.velocity
        )
        wanted = np.where(np.isnan(command.position), by_torque, by_position)
        power_bound = self.power_limit / np.maximum(np.abs(seen.torque), 1e-9)
        bound = np.minimum(power_bound, self.speed_limit)
        return clamp(wanted, bound)


class Drive:
    """State and 0.1 ms step of all drives of a batch; `velocity_phase` (B, 1) delays the loop, in steps."""

    def __init__(
        self, numbers: DriveNumbers, families: list[Family] | None = None, velocity_phase: Array | int = 0
    ) -> None:
        self.numbers = n = numbers
        self.gear = numbers_file()["drive"]["gear_ratio"]
        loops, limits = numbers_file()["loops"], numbers_file()["drive"]
        self.velocity_pi, self.current_pi = loops["velocity_pi"], loops["current_pi"]
        self.current_limit = limits["current_limit"]
        shape = n.motor_inertia.shape
        self.motor_position, self.motor_velocity, self.current = (np.zeros(shape) for _ in range(3))
        self.velocity_integral, self.current_integral = np.zeros(shape), np.zeros(shape)
        self.wanted_velocity, self.wanted_current, self.voltage = (np.zeros(shape) for _ in range(3))
        self.mean_current, self.voltage_wanted = np.zeros(shape), np.zeros(shape)
        self.spring_torque, self.acceleration = np.zeros(shape), np.zeros(shape)
        self.step_count, self.time = 0, 0.0
        # the way that a one-sided spring pulls, 0 for springs that pull both ways
        self.one_sided = MIRROR * (IS_KNEE & numbers_file()["drive"]["knee_spring_one_sided"])
        self.hooks = {
            point: hooked(families or [], point)
            for point in ("attach", "friction", "rotor_torque", "supply", "deflection", "spring", "commit")
        }
        for family in self.hooks["attach"]:
            family.attach(self)
        self.inertia = n.motor_inertia * self.gear**2
        residue = np.arange(VELOCITY_STEPS).reshape(-1, 1, 1)
        self.velocity_due = np.broadcast_to(residue == np.asarray(velocity_phase), (VELOCITY_STEPS, *shape))
        self.decay = np.exp(-n.resistance * STEP / n.inductance)
        self.mean_decay = (1.0 - self.decay) * n.inductance / (n.resistance * STEP)

    def start(self, joint_position: Array, spring_torque: Array) -> None:
        """At rest, the springs deflected by the given torque."""
        n = self.numbers
        stiffness = np.where(self.pulls(spring_torque), n.spring_stiffness, n.stop_stiffness)
        self.motor_position = joint_position + spring_torque / stiffness
        self.spring_torque = spring_torque.copy()

    def pulls(self, deflection: Array) -> Array:
        """Where the main spring carries the load: everywhere but in a knee pushed the wrong way."""
        return deflection * self.one_sided >= 0.0

    def spring(self, deflection: Array, rate: Array) -> Array:
        """Spring torque on the link from motor minus joint angle and its rate, N m."""
        n = self.numbers
        for family in self.hooks["deflection"]:
            deflection = family.deflection(self, deflection)
        pulls = self.pulls(deflection)
        # Where the deflection is exactly zero nothing touches: play carries no damping either.
        damping = np.where(pulls, n.spring_damping, n.stop_damping) * (deflection != 0.0)
        torque = np.where(pulls, n.spring_stiffness, n.stop_stiffness) * deflection + damping * rate
        for family in self.hooks["spring"]:
            torque = family.spring(self, torque, deflection, rate)
        return torque

    def control_currents(self) -> None:
        """Velocity PI every 0.5 ms -> wanted current; current PI -> voltage; both with clamped integrators."""
        n, loop = self.numbers, self.velocity_pi
        due = self.velocity_due[self.step_count % VELOCITY_STEPS]
        if due.any():
            error = self.gear * (self.wanted_velocity - self.motor_velocity)
            step = loop["ki"] * STEP * VELOCITY_STEPS
            integral = clamp(self.velocity_integral + step * error, loop["integrator_limit"])
            wanted = clamp(loop["kp"] * error + integral, self.current_limit)
            self.velocity_integral = np.where(due, integral, self.velocity_integral)
            self.wanted_current = np.where(due, wanted, self.wanted_current)
        loop = self.current_pi
        error = self.wanted_current - self.current
        self.current_integral = clamp(self.current_integral + loop["ki"] * STEP * error, loop["integrator_limit"])
        self.voltage_wanted = loop["kp"] * error + self.current_integral
        supply = n.bus_voltage
        for family in self.hooks["supply"]:
            supply = family.supply(self, supply)
        self.voltage = clamp(self.voltage_wanted, supply)

    def step(self, joint_position: Array, joint_velocity: Array) -> Array:
        """One 0.1 ms from the links' motion at its start -> mean spring torque on the links, N m."""
        self.control_currents()
        torque = self._electronics()
        before = self.motor_velocity
        self.spring_torque = self._mechanics(torque, joint_position, joint_velocity)
        self.acceleration = (self.motor_velocity - before) / STEP
        for family in self.hooks["commit"]:
            family.commit(self)
        self.step_count += 1
        self.time += STEP
        return self.spring_torque

    def _electronics(self) -> Array:
        """The current under the step's voltage -> the motor's mean torque at the rotor, N m."""
        n = self.numbers
        settled = (self.voltage - n.back_emf_constant * self.gear * self.motor_velocity) / n.resistance
        excess = self.current - settled
        self.mean_current = settled + excess * self.mean_decay
        self.current = settled + excess * self.decay
        torque = n.torque_constant * self.mean_current
        for family in self.hooks["rotor_torque"]:
            torque = family.rotor_torque(self, torque)
        return torque

    def _mechanics(self, rotor_torque: Array, joint_position: Array, joint_velocity: Array) -> Array:
        """Motor angle and speed one step on -> mean spring torque over the step, N m."""
        gear, h, angle, speed = self.gear, STEP, self.motor_position, self.motor_velocity
        motor = gear * rotor_torque
        spring = self.spring(angle - joint_position, speed - joint_velocity)
        push = motor - spring
        direction = np.sign(np.where(speed == 0.0, push, speed))
        level, smooth = self.friction(speed, direction)
        drive = push - smooth
        stuck = (speed == 0.0) & (np.abs(drive) <= level)
        slope = (drive - level * direction) / self.inertia
        end_joint = joint_position + h * joint_velocity
        guess = speed + h * np.where(stuck, 0.0, slope)
        end_spring = self.spring(angle + h * speed - end_joint, guess - joint_velocity)
        level, smooth = self.friction(guess, direction)
        drive = motor - smooth - end_spring
        end = speed + 0.5 * h * (slope + (drive - level * direction) / self.inertia)
        end = np.where(stuck, 0.0, end)
        self.motor_position, self.motor_velocity = angle + 0.5 * h * (speed + end), end

        # A speed that would change its sign stops at zero instead, and goes on only if the torque can.
        crosses = end * direction < 0.0
        if crosses.any():
            share = speed / np.where(crosses, speed - end, 1.0)
            breaks = crosses & (np.abs(drive) > level)
            after = np.where(breaks, (drive - level * np.sign(drive)) / self.inertia, 0.0)
            rest = (1.0 - share) * h
            turned = angle + 0.5 * (share * h * speed + rest**2 * after)
            self.motor_position = np.where(crosses, turned, self.motor_position)
            self.motor_velocity = np.where(crosses, after * rest, end)
        return 0.5 * (spring + end_spring)

    def friction(self, speed: Array, direction: Array) -> tuple[Array, Array]:
        """Coulomb level and smooth friction torque at the gear's output for its speed, N m."""
        n, rotor_speed = self.numbers, self.gear * speed
        level, smooth = n.friction_coulomb, n.friction_viscous * rotor_speed
        if n.friction_cubic.any():
            smooth = smooth + n.friction_cubic * rotor_speed**3
        for family in self.hooks["friction"]:
            more_level, more_smooth = family.friction(self, rotor_speed, direction)
            level, smooth = level + more_level, smooth + more_smooth
        return self.gear * np.maximum(level, 0.0), self.gear * smooth
