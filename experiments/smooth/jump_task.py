"""The squat jump as a task with a smooth cost, up to touch-down: the terms that the parameters act on by themselves.

Behind the first touch slopes mean nothing: at the initial guess those of slip, joint stops and standing are a hundred
times longer than apex's, and point elsewhere a hair's breadth away. The landing's terms count in the true cost, which
decides what is kept.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from controller_jax.types import JointTargets, RobotState
from experiments.plant import Plant, PlantParams, PlantState
from experiments.rollout import Score, Tick
from experiments.smooth import squat_jump
from experiments.smooth.laws import WIDTHS, Widths, softplus, step
from experiments.tasks.squat_jump import CONE_EDGE, SquatJumpTask, leg_lengths
from experiments.torque_sensors import as_read
from experiments.trial import Trial

Array = jax.Array
HORIZON = 1.0  # s: a launch that leaves the ground at the last moment has reached its apex
TINY = 1e-8  # added to squares under a root


class SmoothTally(NamedTuple):
    """Sums over ticks until touch-down, as in the task's own tally."""

    apex: Array
    flight: Array
    leg_length: Array
    slip: Array
    tracking: Array
    cone: Array
    stance: Array
    joint_stop: Array
    flown: Array  # () share


@dataclass(frozen=True, eq=False)
class SmoothSquatJump(SquatJumpTask):
    """Static half; parameters, start and settings are the task's own."""

    widths: Widths = WIDTHS

    def start(
        self, plant: Plant, params: PlantParams, settings: Any, values: Array, trial: Trial
    ) -> tuple[PlantState, Any]:
        state, _ = super().start(plant, params, settings, values, trial)
        return state, squat_jump.init()

    def control(
        self, settings: Any, values: Array, state: Any, robot: RobotState, time: Array
    ) -> tuple[Any, JointTargets, Any]:
        jump = self.parameters(values)
        state, targets, info = squat_jump.control(self.widths, self.contact_force, settings, jump, state, robot, time)
        return state, as_read(self.torque_sensors, targets), info

    def first_tally(self) -> SmoothTally:
        return SmoothTally(*(jnp.zeros(()) for _ in SmoothTally._fields))

    def observe(self, tally: SmoothTally, tick: Tick) -> SmoothTally:
        w, info, bodies = self.widths, tick.info, tick.output.bodies
        q = tick.after.bodies.q
        before = 1.0 - info.touched
        dt = self.period * before
        pressed = step(foot_forces(bodies.contact_force) - self.contact_force, w.contact_force)
        leg = leg_lengths(self.settings.geometry, q, bodies.r_WF).mean()
        slide = (jnp.sqrt((bodies.slip_velocity[:, :2] ** 2).sum(-1) + TINY) * pressed).sum()
        limits, joints = self.settings.geometry.position_limits, q[7:]
        beyond = softplus(limits[:, 0] - joints, w.angle)
        beyond = beyond + softplus(joints - limits[:, 1], w.angle)
        return SmoothTally(
            apex=jnp.maximum(tally.apex, q[2] * info.flown * before),  # its slope is that of the highest tick
            flight=tally.flight + dt * info.flown,
            leg_length=tally.leg_length + dt * info.flown * leg,
            slip=tally.slip + dt * slide,
            tracking=tally.tracking + dt * (info.tracking_error**2).sum(),
            cone=tally.cone + dt * softplus(info.cone_use - CONE_EDGE, w.share).mean(),
            stance=tally.stance + dt * (1.0 - info.flown),
            joint_stop=tally.joint_stop + dt * beyond.sum(),
            flown=info.flown,
        )

    def score(self, values: Array, tally: SmoothTally, failed: Array, last: PlantState) -> Score:
        w = self.weights
        terms = {
            "apex": -w["apex"] * tally.apex,
            "leg_length": w["leg_length"] * tally.leg_length / (tally.flight + self.period),
            "slip": w["slip"] * tally.slip,
            "tracking": w["tracking"] * jnp.sqrt(tally.tracking / (tally.stance + self.period) + TINY),
            "cone": w["cone"] * tally.cone / (tally.stance + self.period),
            "joint_stop": w["joint_stop"] * tally.joint_stop,
            "no_flight": w["no_flight"] * (1.0 - tally.flown),
        }
        return Score(sum(terms.values()), terms, {"apex_height": tally.apex})


def foot_forces(contact_force: Array) -> Array:
    """Size (4,) of the contact forces (4, 3), N."""
    return jnp.sqrt((contact_force**2).sum(-1) + TINY)


def smooth_jump_task(task: SquatJumpTask, widths: Widths) -> SmoothSquatJump:
    """The smooth counterpart of a squat jump."""
    ticks = min(task.ticks, round(HORIZON / task.period))
    return SmoothSquatJump(**vars(task) | {"ticks": ticks}, widths=widths)
