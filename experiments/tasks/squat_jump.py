"""The squat jump as a task: the controller of V.C.2 in the closed loop, and the cost terms that the paper names."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from controller_jax import squat_jump
from controller_jax.geometry import geometry_from_numbers
from controller_jax.squat_jump_phases import FLIGHT, LANDING, OVERTIME
from controller_jax.squat_jump_settings import SquatJumpParams, SquatJumpSettings, default_settings
from controller_jax.types import JointTargets, LegGeometry, RobotState
from experiments.errors import UserError
from experiments.files import shown
from experiments.known_numbers import known_numbers
from experiments.model import Model
from experiments.plant import Plant, PlantParams, PlantState
from experiments.rollout import Score, Tick, as_float
from experiments.tasks.definition import TaskDefinition, check_weights
from experiments.torque_sensors import TorqueSensors, as_read, known_torque_sensors
from experiments.trial import Trial
from mjx_starleth.rotation import rotation_matrix
from mjx_starleth.terrain import ground_contact

Array = jax.Array

TERMS = (
    "apex",
    "leg_length",
    "slip",
    "rebound",
    "tracking",
    "cone",
    "joint_stop",
    "standing",
    "no_flight",
    "unsuccessful",
    "fall",
)
PARAMETERS = (
    *(f"height_{i}" for i in range(8)),
    *(f"foot_{i}" for i in range(3)),
    "initial_height",
    "vertical_damping",
)
CONTACT_TOLERANCE = 1e-5  # m that a foot may start inside the ground: rounding
CONE_EDGE = 0.8  # share of the friction cone beyond which a desired force is charged (FACTS 3.5)
FALLEN_HEIGHT = 0.15  # m, torso above ground: lower than any crouch
FALLEN_TILT = 0.7  # cosine of the torso's tilt
REBOUND = 0.01  # s off the ground after touch-down; less is a foot's bounce, not a take-off
STANDING_TIME = 0.5  # s at the end over which standing still is judged
STANDING_SPEED = 0.05  # m/s
STANDING_HEIGHT = 0.05  # m around the landing height


class Tally(NamedTuple):
    """What a jump's score is made of; sums over ticks."""

    apex: Array  # m
    flight: Array  # s between take-off and touch-down
    leg_length: Array  # m s in flight, mean of the legs, hip to foot
    slip: Array  # m, all feet
    rebound: Array  # s with no foot on the ground after touch-down
    tracking: Array  # (N^2 + (N m)^2) s
    cone: Array  # s
    stance: Array  # s
    joint_stop: Array  # rad s beyond the software limits
    touched: Array  # 1.0 from touch-down on
    fallen: Array  # s since the robot fell
    unrest: Array  # m: distance that the torso moves in the final STANDING_TIME
    residual: Array  # N, largest violation of a contact law


@dataclass(frozen=True, eq=False)
class SquatJumpTask:
    """Static half of the task; see squat_jump.json."""

    name: str
    ticks: int
    period: float  # s, of control
    contact_force: float  # N from which a foot counts as on the ground
    settings: SquatJumpSettings
    weights: dict[str, float]
    torque_sensors: TorqueSensors | None = field(default=None, kw_only=True)  # where they err in a known way

    def parameters(self, values: Array) -> SquatJumpParams:
        """The 13 numbers of a value vector (13,)."""
        return SquatJumpParams(values[:8], values[8:11], values[11], values[12])

    def start(
        self, plant: Plant, params: PlantParams, settings: SquatJumpSettings, values: Array, trial: Trial
    ) -> tuple[PlantState, Any]:
        jump = self.parameters(values)
        joints, torque = squat_jump.initial_pose(settings, jump)
        # the joints' inverse kinematics counts from a level torso: the feet touch level ground at the start
        feet = settings.geometry.r_BH_B + settings.geometry.foot_radius * jnp.eye(3)[2:]
        gap = ground_contact(params.bodies.terrain, feet, params.bodies.foot_radius, params.bodies.friction).gap
        height = jump.initial_height + jnp.maximum(-gap.min() - CONTACT_TOLERANCE, 0.0)
        base = jnp.stack([jnp.zeros(()), jnp.zeros(()), height, *jnp.eye(4)[0]])
        return plant.initial_state(params, jnp.concatenate([base, joints]), torque), squat_jump.init(settings, jump)

    def control(
        self, settings: SquatJumpSettings, values: Array, state: Any, robot: RobotState, time: Array
    ) -> tuple[Any, JointTargets, Any]:
        state, targets, info = squat_jump.step(settings, self.parameters(values), state, robot, time)
        return state, as_read(self.torque_sensors, targets), info

    def first_tally(self) -> Tally:
        return Tally(*(jnp.zeros(()) for _ in Tally._fields))

    def observe(self, tally: Tally, tick: Tick) -> Tally:
        dt, info, bodies = self.period, tick.info, tick.output.bodies
        q = tick.after.bodies.q
        pressed = (bodies.contact_force**2).sum(-1) >= self.contact_force**2
        aloft = 1.0 - as_float(pressed.any())
        flying = as_float(info.phase == FLIGHT)
        landing = as_float(info.phase == LANDING)
        took_off = as_float((flying + tally.flight) > 0)
        leg = leg_lengths(self.settings.geometry, q, bodies.r_WF).mean()
        slide = (jnp.sqrt((bodies.slip_velocity[:, :2] ** 2).sum(-1) + 1e-12) * as_float(pressed)).sum()
        limits = self.settings.geometry.position_limits
        joints = q[7:]
        beyond = jnp.maximum(limits[:, 0] - joints, 0) + jnp.maximum(joints - limits[:, 1], 0)
        up = 1 - 2 * (q[4] ** 2 + q[5] ** 2)
        down = (q[2] < FALLEN_HEIGHT) | (up < FALLEN_TILT)
        ending = tick.time >= self.ticks * dt - STANDING_TIME
        speed = jnp.sqrt((tick.after.bodies.u[:3] ** 2).sum())
        return Tally(
            apex=jnp.maximum(tally.apex, q[2] * jnp.maximum(flying, landing)),
            flight=tally.flight + dt * flying,
            leg_length=tally.leg_length + dt * flying * leg,
            slip=tally.slip + dt * slide,
            rebound=tally.rebound + dt * landing * aloft * tally.touched,
            tracking=tally.tracking + dt * (info.tracking_error**2).sum(),
            cone=tally.cone + dt * jnp.maximum(info.cone_use - CONE_EDGE, 0).mean(),
            stance=tally.stance + dt * (1.0 - flying),
            joint_stop=tally.joint_stop + dt * beyond.sum(),
            touched=jnp.maximum(tally.touched, landing * took_off * (1.0 - aloft)),
            fallen=tally.fallen + dt * as_float((tally.fallen > 0) | down),
            unrest=tally.unrest + dt * speed * as_float(ending),
            residual=jnp.maximum(tally.residual, bodies.contact_residual),
        )

    def score(self, values: Array, tally: Tally, failed: Array, last: PlantState) -> Score:
        w = self.weights
        duration = self.ticks * self.period
        flew = as_float(tally.flight > 0)
        # graded: the later a robot falls, the better; one that diverged counts as fallen from the start
        fall = jnp.where(failed > 0, 1.0, jnp.where(tally.fallen > 0, 0.2 + 0.8 * tally.fallen / duration, 0.0))
        height = last.bodies.q[2]
        rests = tally.unrest < STANDING_SPEED * STANDING_TIME
        level = jnp.abs(height - self.settings.landing_height) < STANDING_HEIGHT
        landed = (tally.touched > 0) & (tally.fallen == 0) & (failed == 0) & rests & level
        success = as_float(landed & (tally.rebound < REBOUND))
        terms = {
            "apex": -w["apex"] * tally.apex,
            "leg_length": w["leg_length"] * tally.leg_length / jnp.maximum(tally.flight, self.period),
            "slip": w["slip"] * tally.slip,
            "rebound": w["rebound"] * tally.rebound,
            "tracking": w["tracking"] * jnp.sqrt(tally.tracking / jnp.maximum(tally.stance, self.period)),
            "cone": w["cone"] * tally.cone / jnp.maximum(tally.stance, self.period),
            "joint_stop": w["joint_stop"] * tally.joint_stop,
            "standing": w["standing"] * tally.unrest,
            "no_flight": w["no_flight"] * (1.0 - flew),
            "unsuccessful": w["unsuccessful"] * (1.0 - success),  # what the gate counts, the search pays for
            "fall": w["fall"] * fall,
        }
        metrics = {
            "apex_height": tally.apex,
            "landed": as_float(landed),
            "rebound_time": tally.rebound,
            "slip_distance": tally.slip,
            "flight_time": tally.flight,
            "final_height": height,
            "final_speed": tally.unrest / STANDING_TIME,
            "contact_residual": tally.residual,
            "success": success,
        }
        cost = sum(terms.values())
        return Score(jnp.where(jnp.isfinite(cost), cost, 2 * w["fall"]), terms, metrics)


METRIC_UNITS = {
    "apex_height": "m",
    "landed": "bool",
    "rebound_time": "s",
    "slip_distance": "m",
    "flight_time": "s",
    "final_height": "m",
    "final_speed": "m/s",
    "contact_residual": "N",
    "success": "bool",
}


def leg_lengths(geometry: LegGeometry, q: Array, r_WF: Array) -> Array:
    """Distance (4,) of each foot's centre (4, 3) from its hip (HAA axis) at torso pose q (7 or more), m."""
    r_WH = q[None, :3] + (rotation_matrix(q[3:7])[None] * geometry.r_BH_B[:, None]).sum(-1)
    return jnp.sqrt(((r_WF - r_WH) ** 2).sum(-1))


def make_task(definition: TaskDefinition, model: Model) -> SquatJumpTask:
    """The task on a robot's numbers. Raises UserError: weights, parameters, settings, a duration too short."""
    check_weights(definition.weights, TERMS, definition.task)
    names = tuple(parameter.name for parameter in definition.parameters)
    if names != PARAMETERS:
        raise UserError(f"Task {definition.task}: its parameters are {', '.join(PARAMETERS)}, in this order.")
    if definition.settings:
        key = shown(min(definition.settings))
        raise UserError(f"Task {definition.task}: it has no settings; remove the key '{key}' from them.")
    numbers = known_numbers(model)
    period = numbers["loops"]["control_period"]
    settings = default_settings(geometry_from_numbers(numbers), period)
    shortest = float(settings.crouch_time + settings.launch_time) + OVERTIME + STANDING_TIME
    if definition.duration < shortest:
        raise UserError(f"Task {definition.task}: a duration of {definition.duration:g} s is too short for a jump.")
    contact_force = numbers["contact"]["contact_flag_force"]
    ticks = round(definition.duration / period)
    sensors = known_torque_sensors(model)
    task, weights = definition.task, definition.weights
    return SquatJumpTask(task, ticks, period, contact_force, settings, weights, torque_sensors=sensors)
