"""Periodic gaits as tasks (V.C.3): walk, trot, bound and pronk in the closed loop; gait_score.py judges them."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

from controller_jax import careful_gait
from controller_jax.careful_gait import CarefulGait, CarefulState
from controller_jax.geometry import geometry_from_numbers
from controller_jax.joint_torques import joint_torques, weight_torque
from controller_jax.leg_kinematics import inverse_kinematics, leg_kinematics
from controller_jax.locomotion import GaitParams, LocomotionInfo
from controller_jax.rotations import control_frame, mv
from controller_jax.torso_motion import along_slope
from controller_jax.types import JointTargets, RobotState
from controller_jax.velocity_command import VelocityCommand
from experiments.errors import UserError
from experiments.files import shown
from experiments.known_numbers import known_numbers
from experiments.model import Model
from experiments.plant import Plant, PlantParams, PlantState
from experiments.rollout import Score, Tick
from experiments.tasks.definition import TaskDefinition, check_weights
from experiments.tasks.gait_parameters import (
    GaitSettings,
    careful_from_settings,
    check_names,
    controller_from_settings,
    with_values,
)
from experiments.tasks.gait_score import METRIC_UNITS as METRIC_UNITS  # the registry asks the module of a task for it
from experiments.tasks.gait_score import TERMS, GaitJudge, GaitTally
from experiments.torque_sensors import TorqueSensors, as_read, known_torque_sensors
from experiments.trial import Trial
from mjx_starleth.rotation import matrix_quaternion

Array = jax.Array

SETTLING_TIME = 1.0  # s from the end of the blend until the gait is judged


@dataclass(frozen=True, eq=False)
class GaitTask:
    """Static half of the task; see the JSON files beside."""

    name: str
    names: tuple[str, ...]  # of the searched parameters
    ticks: int
    period: float  # s, of control
    contact_force: float  # N from which a foot counts as on the ground
    settings: GaitSettings
    weights: dict[str, float]
    torque_sensors: TorqueSensors | None = field(default=None, kw_only=True)  # where they err in a known way

    @property
    def settled(self) -> float:
        """Time [s] from which the gait is judged: one second after the blend into it has ended."""
        start = self.settings.controller.start
        return float(start.stand) + float(start.blend) + SETTLING_TIME

    def parameters(self, settings: GaitSettings, values: Array) -> GaitParams:
        """The controller with the searched values (n,) put in."""
        controller = settings.controller._replace(distribution=settings.distribution)
        return with_values(controller, self.names, values)

    def both_forms(self, settings: GaitSettings, values: Array) -> CarefulGait:
        """The gait with the searched values (n,) put in, and its careful form, which is not searched."""
        limits = settings.distribution.torque_limits
        distribution = settings.careful.distribution._replace(torque_limits=limits)
        careful = settings.careful._replace(distribution=distribution)
        return CarefulGait(self.parameters(settings, values), careful, settings.caution)

    def start(
        self, plant: Plant, params: PlantParams, settings: GaitSettings, values: Array, trial: Trial
    ) -> tuple[PlantState, CarefulState]:
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
        q = jnp.concatenate([r_WB, matrix_quaternion(R_WB), joints])
        robot = RobotState(q[:3], R_WB, jnp.zeros(3), jnp.zeros(3), joints, jnp.zeros(12), jnp.ones(4))
        legs = leg_kinematics(geometry, joints)
        share = 0.25 * geometry.gravity * params.bodies.mass.sum()
        force_B = jnp.broadcast_to(share * up_B, (4, 3))
        torque = joint_torques(force_B, legs.J_BF_B, weight_torque(geometry, legs, R_WB))
        controller = careful_gait.init(self.both_forms(settings, values), geometry, robot)
        return plant.initial_state(params, q, torque), controller

    def control(
        self, settings: GaitSettings, values: Array, state: CarefulState, robot: RobotState, time: Array
    ) -> tuple[CarefulState, JointTargets, LocomotionInfo]:
        command, params = settings.command_at(time), self.both_forms(settings, values)
        period = jnp.float32(self.period)
        state, targets, info = careful_gait.step(params, settings.geometry, state, robot, command, time, period)
        return state, as_read(self.torque_sensors, targets), info

    @property
    def judge(self) -> GaitJudge:
        """What scores the gait."""
        duration = self.ticks * self.period
        return GaitJudge(self.settings, self.weights, duration, self.period, self.settled, self.contact_force)

    def first_tally(self) -> GaitTally:
        return GaitTally.first()

    def observe(self, tally: GaitTally, tick: Tick) -> GaitTally:
        return self.judge.observe(tally, tick)

    def score(self, values: Array, tally: GaitTally, failed: Array, last: PlantState) -> Score:
        return self.judge.score(tally, failed, self.parameters(self.settings, values).gait.cycle_duration)


def make_task(definition: TaskDefinition, model: Model) -> GaitTask:
    """The task on a robot's numbers. Raises UserError for wrong weights, parameters or settings."""
    task = definition.task
    check_weights(definition.weights, TERMS, task)
    names = tuple(parameter.name for parameter in definition.parameters)
    check_names(names, task)
    numbers = known_numbers(model)
    geometry = geometry_from_numbers(numbers)
    known = {"controller", "command", "flight", "turn_start"}
    wrong = set(definition.settings) - {"careful"} ^ known
    if wrong:
        raise UserError(
            f"Task {task}: its settings are {', '.join(sorted(known))}, and perhaps careful; correct the key "
            f"'{shown(min(wrong))}'."
        )
    controller = controller_from_settings(definition.settings["controller"], numbers, task)
    careful, caution = careful_from_settings(definition.settings.get("careful"), controller, numbers, task)
    command = definition.settings["command"]
    if set(command) != set(VelocityCommand._fields):
        raise UserError(f"Task {task}: settings.command needs {', '.join(VelocityCommand._fields)}.")
    settings = GaitSettings(
        geometry=geometry,
        distribution=controller.distribution,
        controller=controller,
        careful=careful,
        caution=caution,
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
