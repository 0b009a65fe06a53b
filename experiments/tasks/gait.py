"""Periodic gaits as tasks (V.C.3): walk, trot, bound and pronk in the closed loop, with the paper's cost terms."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from controller_jax import locomotion
from controller_jax.geometry import geometry_from_numbers
from controller_jax.joint_torques import joint_torques, weight_torque
from controller_jax.leg_kinematics import inverse_kinematics, leg_kinematics
from controller_jax.locomotion import GaitParams, LocomotionState
from controller_jax.rotations import control_frame, mv
from controller_jax.torso_motion import along_slope
from controller_jax.types import JointTargets, LegGeometry, RobotState
from controller_jax.velocity_command import VelocityCommand
from experiments.errors import UserError
from experiments.files import shown
from experiments.known_numbers import known_numbers
from experiments.model import Model
from experiments.plant import Plant, PlantParams, PlantState
from experiments.rollout import Score, Tick
from experiments.tasks.definition import TaskDefinition, check_weights
from experiments.tasks.gait_parameters import check_names, controller_from_settings, with_values
from experiments.torque_sensors import TorqueSensors, as_read, known_torque_sensors
from experiments.trial import Trial
from mjx_starleth.rotation import rotation_matrix

Array = jax.Array

TERMS = (
    "fall",
    "flight",
    "schedule",
    "speed",
    "drift",
    "turning",
    "unrest",
    "slip",
    "tracking",
    "cone",
    "joint_stop",
)
FALLEN_HEIGHT = 0.2  # m, torso above the lowest foot's centre: lower than any gait
FALLEN_TILT = 0.6  # cosine of the angle between torso and ground
CONE_EDGE = 0.8  # share of the friction cone beyond which a desired force is charged (FACTS 3.5)
SETTLING_TIME = 1.0  # s from the end of the blend until the gait is judged


class GaitSettings(NamedTuple):
    """What is not searched, beside the searched numbers' first values."""

    geometry: LegGeometry
    distribution: Any  # of the force distribution; replaces the one in `controller`
    controller: GaitParams
    command: VelocityCommand
    flight: Array  # () wanted share of the stride with all feet in the air
    turn_start: Array  # () s, when the turning command sets in


class GaitTally(NamedTuple):
    """Sums over the ticks after the gait has settled in, unless said."""

    time: Array  # s
    upright: Array  # s since the start without a fall
    fallen: Array  # 1.0 after a fall
    flight: Array  # s with all feet in the air
    schedule: Array  # s, feet whose contact is not as planned, mean of the four
    velocity_C: Array  # (2,) m, way in heading and lateral direction
    turned: Array  # rad
    unrest: Array  # rad^2/s, roll and pitch rates off the desired ones, squared
    slip: Array  # m
    tracking: Array  # (N^2 + (N m)^2) s
    cone: Array  # s
    joint_stop: Array  # rad s
    residual: Array  # N, largest violation of a contact law


@dataclass(frozen=True, eq=False)
class GaitTask:
    """Static half of the task; see the JSON files beside."""

    name: str
    names: tuple[str, ...]  # of the searched parameters
    ticks: int
    period: float
    contact_force: float  # N from which a foot counts as on the ground
    settings: GaitSettings
    weights: dict[str, float]
    torque_sensors: TorqueSensors | None = field(default=None, kw_only=True)  # where they err in a known way

    @property
    def settled(self) -> float:
        """Time from which the gait is judged: one second after the blend into it has ended."""
        start = self.settings.controller.start
        return float(start.stand) + float(start.blend) + SETTLING_TIME

    def parameters(self, settings: GaitSettings, values: Array) -> GaitParams:
        """The controller with the searched values (n,) put in."""
        controller = settings.controller._replace(distribution=settings.distribution)
        return with_values(controller, self.names, values)

    def start(
        self, plant: Plant, params: PlantParams, settings: GaitSettings, values: Array, trial: Trial
    ) -> tuple[PlantState, LocomotionState]:
        """Torso turned as the gait wants it on the slope, feet under the hips along gravity: the telescopic strut."""
        geometry, terrain = settings.geometry, params.bodies.terrain
        level = leg_kinematics(geometry, jnp.asarray(plant.bodies.stance[7:])).r_BF_B - geometry.r_BH_B
        normal, up = terrain.normal, jnp.array([0.0, 0.0, 1.0], jnp.float32)
        turned = self.parameters(settings, values).torso.slope_share
        R_WB = along_slope(turned, control_frame(jnp.eye(3, dtype=jnp.float32), normal))
        up_B, r_BH_W = R_WB[2], mv(R_WB[None], geometry.r_BH_B)
        uphill = -(r_BH_W[:, :2] * normal[None, :2]).sum(-1) / normal[2]  # rise of the ground from torso to hip
        height = -level[:, 2].mean() - geometry.r_BH_B[:, 2].mean()  # of the torso's origin above the feet's plane
        drop = height + r_BH_W[:, 2] - uphill
        joints = inverse_kinematics(geometry, geometry.r_BH_B + level.at[:, 2].set(0.0) - drop[:, None] * up_B[None])
        r_WB = terrain.offset * normal + (height + geometry.foot_radius / normal[2]) * up
        q = jnp.concatenate([r_WB, quaternion(R_WB), joints])
        robot = RobotState(q[:3], R_WB, jnp.zeros(3), jnp.zeros(3), joints, jnp.zeros(12), jnp.ones(4))
        legs = leg_kinematics(geometry, joints)
        share = 0.25 * geometry.gravity * params.bodies.mass.sum()
        force_B = jnp.broadcast_to(share * up_B, (4, 3))
        torque = joint_torques(force_B, legs.J_BF_B, weight_torque(geometry, legs, R_WB))
        return plant.initial_state(params, q, torque), locomotion.init(geometry, robot)

    def control(
        self, settings: GaitSettings, values: Array, state: LocomotionState, robot: RobotState, time: Array
    ) -> tuple[LocomotionState, JointTargets, locomotion.LocomotionInfo]:
        command = settings.command
        command = command._replace(turning=jnp.where(time >= settings.turn_start, command.turning, 0.0))
        params = self.parameters(settings, values)
        period = jnp.float32(self.period)
        state, targets, info = locomotion.step(params, settings.geometry, state, robot, command, time, period)
        return state, as_read(self.torque_sensors, targets), info

    def first_tally(self) -> GaitTally:
        zero = jnp.zeros(())
        return GaitTally(*(zero,) * 5, jnp.zeros(2), *(zero,) * 7)

    def observe(self, tally: GaitTally, tick: Tick) -> GaitTally:
        dt, info, bodies = self.period, tick.info, tick.output.bodies
        q, u = tick.after.bodies.q, tick.after.bodies.u
        R = rotation_matrix(q[3:7])
        normal = info.plane.normal_W
        height = ((q[None, :3] - bodies.r_WF) * normal[None]).sum(-1).max()  # above the lowest foot
        down = (height < FALLEN_HEIGHT) | ((R[:, 2] * normal).sum() < FALLEN_TILT)
        fallen = jnp.maximum(tally.fallen, as_float(down))
        up = 1.0 - fallen
        settled = up * as_float(tick.time >= self.settled)
        pressed = (bodies.contact_force**2).sum(-1) >= self.contact_force**2
        aloft = 1.0 - as_float(pressed.any())
        off_plan = jnp.abs(as_float(pressed) - info.planned_stance).mean()
        heading = R[:, 0] - normal * (R[:, 0] * normal).sum()
        heading = heading / jnp.sqrt((heading * heading).sum() + 1e-12)
        lateral = jnp.cross(normal, heading)
        v = jnp.stack([(u[:3] * heading).sum(), (u[:3] * lateral).sum()])
        rates = u[3:6] - (R * info.torso.omega_W[:, None]).sum(0)
        slide = (jnp.sqrt((bodies.slip_velocity**2).sum(-1) + 1e-12) * as_float(pressed)).sum()
        limits = self.settings.geometry.position_limits
        low, high = limits[:, 0] - q[7:], q[7:] - limits[:, 1]
        use = jnp.sqrt((info.force_C[:, :2] ** 2).sum(-1) + 1e-12) / jnp.maximum(info.force_C[:, 2], 1.0)
        use = use / self.settings.distribution.friction
        return GaitTally(
            time=tally.time + dt * settled,
            upright=tally.upright + dt * up,
            fallen=fallen,
            flight=tally.flight + dt * settled * aloft,
            schedule=tally.schedule + dt * settled * off_plan,
            velocity_C=tally.velocity_C + dt * settled * v,
            turned=tally.turned + dt * settled * (u[3:6] * (R * normal[:, None]).sum(0)).sum(),
            unrest=tally.unrest + dt * settled * (rates[:2] ** 2).sum(),
            slip=tally.slip + dt * settled * slide,
            tracking=tally.tracking + dt * settled * (info.tracking_C**2).sum(),
            cone=tally.cone + dt * settled * (jnp.maximum(use - CONE_EDGE, 0.0) * info.support).mean(),
            joint_stop=tally.joint_stop + dt * settled * (jnp.maximum(low, 0) + jnp.maximum(high, 0)).sum(),
            residual=jnp.maximum(tally.residual, bodies.contact_residual),
        )

    def score(self, values: Array, tally: GaitTally, failed: Array, last: PlantState) -> Score:
        w, settings = self.weights, self.settings
        duration = self.ticks * self.period
        judged = jnp.maximum(tally.time, self.period)
        command, speed = settings.command, tally.velocity_C / judged
        turning = tally.turned / judged
        aloft = tally.flight / judged
        shortfall = jnp.maximum(settings.flight - aloft, 0.0) / jnp.maximum(settings.flight, 1e-3)
        fell = jnp.maximum(tally.fallen, failed)
        terms = {
            # graded: the later a robot falls, the better; but half is for falling at all, or one fall among many
            # trials would weigh less than a little speed
            "fall": w["fall"] * (1.0 - 0.5 * tally.upright / duration) * fell,
            "flight": w["flight"] * shortfall,
            "schedule": w["schedule"] * tally.schedule / judged,
            "speed": w["speed"] * jnp.abs(speed[0] - command.heading),
            "drift": w["drift"] * jnp.abs(speed[1] - command.lateral),
            "turning": w["turning"] * jnp.abs(turning - command.turning),
            "unrest": w["unrest"] * jnp.sqrt(tally.unrest / judged),
            "slip": w["slip"] * tally.slip / judged,
            "tracking": w["tracking"] * jnp.sqrt(tally.tracking / judged),
            "cone": w["cone"] * tally.cone / judged,
            "joint_stop": w["joint_stop"] * tally.joint_stop / judged,
        }
        stride = self.parameters(settings, values).gait.cycle_duration
        metrics = {
            "cycles": jnp.maximum(tally.upright - float(settings.controller.start.stand), 0.0) / stride,
            "upright_time": tally.upright,
            "survived": 1.0 - fell,
            "heading_speed": speed[0],
            "lateral_speed": speed[1],
            "turning_rate": turning,
            "flight_fraction": aloft,
            "schedule_mismatch": tally.schedule / judged,
            "slip_speed": tally.slip / judged,
            "contact_residual": tally.residual,
            "success": 1.0 - fell,
        }
        cost = sum(terms.values())
        return Score(jnp.where(jnp.isfinite(cost), cost, 2 * w["fall"]), terms, metrics)


METRIC_UNITS = {
    "cycles": "1",
    "upright_time": "s",
    "survived": "bool",
    "heading_speed": "m/s",
    "lateral_speed": "m/s",
    "turning_rate": "rad/s",
    "flight_fraction": "1",
    "schedule_mismatch": "1",
    "slip_speed": "m/s",
    "contact_residual": "N",
    "success": "bool",
}


def quaternion(R: Array) -> Array:
    """Unit quaternion (4,), scalar first, of a rotation (3, 3) by less than half a turn."""
    w = 0.5 * jnp.sqrt(jnp.maximum(1.0 + R[0, 0] + R[1, 1] + R[2, 2], 1e-12))
    axis = jnp.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return jnp.concatenate([w[None], axis / (4.0 * w)])


def as_float(condition: Array) -> Array:
    """1.0 where true."""
    return condition.astype(jnp.float32)


def make_task(definition: TaskDefinition, model: Model) -> GaitTask:
    """The task on a robot's numbers. Raises UserError for wrong weights, parameters or settings."""
    task = definition.task
    check_weights(definition.weights, TERMS, task)
    names = tuple(parameter.name for parameter in definition.parameters)
    check_names(names, task)
    numbers = known_numbers(model)
    geometry = geometry_from_numbers(numbers)
    known = {"controller", "command", "flight", "turn_start"}
    wrong = set(definition.settings) ^ known
    if wrong:
        raise UserError(
            f"Task {task}: its settings are {', '.join(sorted(known))}; correct the key '{shown(min(wrong))}'."
        )
    controller = controller_from_settings(definition.settings["controller"], numbers, task)
    command = definition.settings["command"]
    if set(command) != set(VelocityCommand._fields):
        raise UserError(f"Task {task}: settings.command needs {', '.join(VelocityCommand._fields)}.")
    settings = GaitSettings(
        geometry=geometry,
        distribution=controller.distribution,
        controller=controller,
        command=VelocityCommand(**{name: jnp.float32(value) for name, value in command.items()}),
        flight=jnp.float32(definition.settings["flight"]),
        turn_start=jnp.float32(definition.settings["turn_start"]),
    )
    period, contact_force = numbers["loops"]["control_period"], numbers["contact"]["contact_flag_force"]
    ticks = round(definition.duration / period)
    sensors = known_torque_sensors(model)
    weights = definition.weights
    made = GaitTask(task, names, ticks, period, contact_force, settings, weights, torque_sensors=sensors)
    if definition.duration <= made.settled:
        raise UserError(
            f"Task {task}: {definition.duration:g} s are too short: the gait is judged from {made.settled:g} s on."
        )
    return made
