"""How well a gait goes: sums over the control periods of a trial, and the paper's cost terms from them (V.C.3)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from experiments.rollout import Score, Tick, as_float
from experiments.tasks.gait_parameters import GaitSettings
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

    @staticmethod
    def first() -> "GaitTally":
        """Before the first control period."""
        zero = jnp.zeros(())
        return GaitTally(*(zero,) * 5, jnp.zeros(2), *(zero,) * 7)


@dataclass(frozen=True, eq=False)
class GaitJudge:
    """What a gait is judged by."""

    settings: GaitSettings
    weights: Mapping[str, float]  # by TERMS
    duration: float  # s, of a trial
    period: float  # s, of control
    settled: float  # s from the start, from when the gait is judged
    contact_force: float  # N from which a foot counts as on the ground

    def observe(self, tally: GaitTally, tick: Tick) -> GaitTally:
        """The tally with one more control period."""
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

    def score(self, tally: GaitTally, failed: Array, stride: Array) -> Score:
        """Cost, its terms and metrics; `failed` () is 1.0 for a rollout that diverged, `stride` () the cycle in s."""
        w, settings = self.weights, self.settings
        judged = jnp.maximum(tally.time, self.period)
        command, speed = settings.command, tally.velocity_C / judged
        turning = tally.turned / judged
        aloft = tally.flight / judged
        shortfall = jnp.maximum(settings.flight - aloft, 0.0) / jnp.maximum(settings.flight, 1e-3)
        fell = jnp.maximum(tally.fallen, failed)
        terms = {
            # graded: the later a robot falls, the better; but half is for falling at all, or one fall among many
            # trials would weigh less than a little speed
            "fall": w["fall"] * (1.0 - 0.5 * tally.upright / self.duration) * fell,
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
