"""A gait as a task with a smooth cost, over one stride once it has settled in.

Every touch-down makes slopes longer: over the start of a walking trot and two strides by a factor of 1e4, and what is
left tells nothing of where to go. So the true rollout brings the robot to its stride, and from that state, which is
held as it is, the smooth one takes the slope of the next. A fall has no slope: that term counts in the true cost
alone, which decides what is kept.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from controller_jax.types import JointTargets, RobotState
from experiments.plant import Plant, PlantParams, PlantState
from experiments.rollout import Rollout, Score, Tick
from experiments.smooth import gait
from experiments.smooth.laws import WIDTHS, Widths, softplus, step
from experiments.tasks.gait import GaitTask
from experiments.tasks.gait_score import CONE_EDGE
from experiments.torque_sensors import as_read
from experiments.trial import Trial
from mjx_starleth.rotation import rotation_matrix

Array = jax.Array
JUDGED_TIME = 0.7  # s: a stride of any gait
TINY = 1e-8  # added to squares under a root


class SmoothGaitTally(NamedTuple):
    """Sums over ticks, as in the task's own tally."""

    flight: Array
    schedule: Array
    velocity_C: Array  # (2,)
    turned: Array
    unrest: Array
    slip: Array
    tracking: Array
    cone: Array
    joint_stop: Array


@dataclass(frozen=True, eq=False)
class SmoothGait(GaitTask):
    """Static half; parameters and settings are the task's own. Its time zero is when the gait has settled in."""

    before: Rollout  # the true one
    widths: Widths = WIDTHS

    def start(
        self, plant: Plant, params: PlantParams, settings: Any, values: Array, trial: Trial
    ) -> tuple[PlantState, Any]:
        """Plant and controller in their stride."""
        loop, values = self.before, jax.lax.stop_gradient(values)
        state, controller = loop.task.start(loop.plant, params, settings, values, trial)
        alive = jnp.ones((), jnp.float32)
        carry = (state, controller, loop.sensing.start(state), loop.task.first_tally(), alive)

        def tick(carry, k):
            return loop.tick(params, settings, values, trial, carry, k)[0], None

        (state, controller, *_), _ = jax.lax.scan(tick, carry, jnp.arange(round(self.settled / self.period)))
        return state, gait.init(controller.gait)

    def control(
        self, settings: Any, values: Array, state: Any, robot: RobotState, time: Array
    ) -> tuple[Any, JointTargets, Any]:
        time = time + self.settled
        command, params = settings.command_at(time), self.parameters(settings, values)
        state, targets, info = gait.control(
            self.widths,
            self.contact_force,
            params,
            settings.geometry,
            state,
            robot,
            command,
            time,
            jnp.float32(self.period),
        )
        return state, as_read(self.torque_sensors, targets), info

    def first_tally(self) -> SmoothGaitTally:
        zero = jnp.zeros(())
        return SmoothGaitTally(zero, zero, jnp.zeros(2), *(zero,) * 6)

    def observe(self, tally: SmoothGaitTally, tick: Tick) -> SmoothGaitTally:
        w, info, bodies = self.widths, tick.info, tick.output.bodies
        q, u = tick.after.bodies.q, tick.after.bodies.u
        dt = self.period
        R, normal = rotation_matrix(q[3:7]), info.plane.normal_W
        pressed = step(jnp.sqrt((bodies.contact_force**2).sum(-1) + TINY) - self.contact_force, w.contact_force)
        heading = R[:, 0] - normal * (R[:, 0] * normal).sum()
        heading = heading / jnp.sqrt((heading * heading).sum() + TINY)
        along = jnp.stack([(u[:3] * heading).sum(), (u[:3] * jnp.cross(normal, heading)).sum()])
        rates = u[3:6] - (R * info.torso.omega_W[:, None]).sum(0)
        slide = (jnp.sqrt((bodies.slip_velocity**2).sum(-1) + TINY) * pressed).sum()
        limits, joints = self.settings.geometry.position_limits, q[7:]
        beyond = softplus(limits[:, 0] - joints, w.angle)
        beyond = beyond + softplus(joints - limits[:, 1], w.angle)
        now = SmoothGaitTally(
            flight=jnp.prod(1.0 - pressed),
            schedule=jnp.sqrt((pressed - info.support) ** 2 + TINY).mean(),
            velocity_C=along,
            turned=(u[3:6] * (R * normal[:, None]).sum(0)).sum(),
            unrest=(rates[:2] ** 2).sum(),
            slip=slide,
            tracking=(info.tracking_C**2).sum(),
            cone=softplus(info.cone_use - CONE_EDGE, w.share).mean(),
            joint_stop=beyond.sum(),
        )
        return jax.tree.map(lambda total, x: total + dt * x, tally, now)

    def score(self, values: Array, tally: SmoothGaitTally, failed: Array, last: PlantState) -> Score:
        w, width, command = self.weights, self.widths, self.settings.command
        mean = jax.tree.map(lambda x: x / (self.ticks * self.period), tally)
        wanted = self.settings.flight
        shortfall = softplus(wanted - mean.flight, width.share) / jnp.maximum(wanted, 1e-3)
        terms = {
            "flight": w["flight"] * jnp.where(wanted > 0.0, shortfall, 0.0),  # a walk is not asked to fly
            "schedule": w["schedule"] * mean.schedule,
            "speed": w["speed"] * _size(mean.velocity_C[0] - command.heading, width.rate),
            "drift": w["drift"] * _size(mean.velocity_C[1] - command.lateral, width.rate),
            "turning": w["turning"] * _size(mean.turned - command.turning, width.rate),
            "unrest": w["unrest"] * jnp.sqrt(mean.unrest + TINY),
            "slip": w["slip"] * mean.slip,
            "tracking": w["tracking"] * jnp.sqrt(mean.tracking + TINY),
            "cone": w["cone"] * mean.cone,
            "joint_stop": w["joint_stop"] * mean.joint_stop,
        }
        return Score(sum(terms.values()), terms, {"heading_speed": mean.velocity_C[0], "failed": failed})


def _size(x: Array, width: float) -> Array:
    """|x| with its corner rounded."""
    return jnp.sqrt(x * x + width * width) - width


def smooth_gait_task(before: Rollout, widths: Widths) -> SmoothGait:
    """The smooth counterpart of a gait's true rollout."""
    task = before.task
    return SmoothGait(**vars(task) | {"ticks": round(JUDGED_TIME / task.period)}, before=before, widths=widths)
