"""The plant: drives, bodies, effects and joint sensors for one control period (paper Fig. 2, right half)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from experiments.effects.compose import ActiveEffects, EffectNumbers, Placement, activate
from experiments.effects.effect import Effect
from experiments.effects.library import LIBRARY
from experiments.errors import UserError
from experiments.model import Model
from mjx_starleth.bodies import Bodies, BodyInput, BodyOutput, BodyParams, BodyState, make_bodies
from mjx_starleth.numbers import RobotNumbers
from sea_jax import (
    DRIVES,
    DriveOutput,
    DriveParams,
    DriveState,
    JointCommand,
    JointMeasurement,
    JointMotion,
    LoopPeriods,
    initial_state,
    params_from_numbers,
    periods_from_numbers,
)
from sea_jax.hooks import link_signals, no_signals

Array = jax.Array


class PlantParams(NamedTuple):
    """Every number of the plant that a search, a perturbation or a fit may change."""

    drive: DriveParams
    bodies: BodyParams
    effects: EffectNumbers


class PlantState(NamedTuple):
    """What the scan carries."""

    bodies: BodyState
    drive: DriveState
    torque: Array  # (12,) spring torque that the sensor shows now, N m
    contact_force: Array  # (4, 3) mean over the last period, world frame, N
    sensor_memory: tuple[Array, ...]


class PlantInput(NamedTuple):
    """What acts on the plant for one control period."""

    command: JointCommand
    measurement: JointMeasurement  # what the joint controllers act on
    wrench_W: Array  # (6,) disturbance on the torso origin, world frame, N and N m


class PlantOutput(NamedTuple):
    """What one control period produced."""

    drive: DriveOutput
    bodies: BodyOutput


@dataclass(frozen=True, eq=False)
class Plant:
    """Static half of the plant; `params` is its numeric half at nominal."""

    bodies: Bodies
    drive: str
    drive_step: Callable
    periods: LoopPeriods
    effects: ActiveEffects
    params: PlantParams
    numbers: RobotNumbers
    placements: tuple[Placement, ...] = ()

    def prepare(self, params: PlantParams) -> PlantParams:
        """Apply, once a rollout, the effects that change a number of the plant."""
        return params._replace(
            drive=self.effects.apply("drive_parameters", params.effects, params.drive),
            bodies=self.effects.apply("body_parameters", params.effects, params.bodies),
        )

    def initial_state(self, params: PlantParams, q: Array, joint_torque: Array) -> PlantState:
        """At rest in generalised coordinates q (19,), the springs carrying joint_torque (12,)."""
        memory = self.effects.memory()
        sensors = memory.pop("measurement", ())
        drive = initial_state(params.drive, q[7:], joint_torque, memory)
        bodies = BodyState(q, jnp.zeros(18, jnp.float32), jnp.zeros((4, 3), jnp.float32))
        return PlantState(bodies, drive, joint_torque, jnp.zeros((4, 3), jnp.float32), sensors)

    def measure(self, params: PlantParams, state: PlantState) -> tuple[PlantState, JointMeasurement]:
        """What the joint sensors show now, faults included, noise not."""
        q, u = state.bodies.q, state.bodies.u
        measurement = JointMeasurement(q[7:], u[6:], state.torque, state.drive.motor_position)
        hooks = self.effects.hooks("measurement", params.effects)
        if not hooks:
            return state, measurement
        signals = link_signals(link_motion(state), self.periods.control)
        before = state.sensor_memory or (None,) * len(hooks)
        after = []
        for hook, memory in zip(hooks, before, strict=True):
            measurement, memory = hook(measurement, signals, memory)
            after.append(memory)
        return state._replace(sensor_memory=tuple(after) if state.sensor_memory else ()), measurement

    def step(self, params: PlantParams, state: PlantState, inputs: PlantInput) -> tuple[PlantState, PlantOutput]:
        """One control period: the drives move against the links' motion, then the links move under their torque.

        `params` comes from `prepare`.
        """
        drive, acting = self.drives_step(params, state, inputs)
        return joined(state, drive, self.bodies.step(params.bodies, state.bodies, acting))

    def drives_step(
        self, params: PlantParams, state: PlantState, inputs: PlantInput
    ) -> tuple[tuple[DriveState, DriveOutput], BodyInput]:
        """The drives' half of a period, and all that then acts on the bodies, whoever moves them."""
        numbers = params.effects
        motion = link_motion(state)
        drive, output = self.drive_step(
            params.drive,
            state.drive,
            (inputs.command, inputs.measurement, motion),
            self.effects.drive_hooks(numbers),
            self.periods,
        )
        drag, drag_damping = self._drag(numbers, motion)
        push = self.effects.apply("torso_force", numbers, jnp.zeros(3, jnp.float32), None)
        acting = BodyInput(
            joint_torque=output.torque - drag,
            joint_damping=output.damping + drag_damping,
            wrench_W=inputs.wrench_W.at[:3].add(push) if self._has("torso_force") else inputs.wrench_W,
        )
        return (drive, output), acting

    def _has(self, hook: str) -> bool:
        return any(hook in effect.equations for effect in self.effects.effects)

    def _drag(self, numbers: EffectNumbers, motion: JointMotion) -> tuple[Array, Array]:
        """Drag on the links and its slope, so that a steep dry law stays stable in the bodies' step."""
        zero = jnp.zeros_like(motion.velocity)
        if not self._has("joint_drag"):
            return zero, zero

        def drag(velocity):
            signals = no_signals(velocity, self.periods.control)
            signals = signals._replace(
                joint_position=motion.position, joint_velocity=velocity, radial_load=motion.radial_load
            )
            return self.effects.apply("joint_drag", numbers, zero, signals)

        return jax.jvp(drag, (motion.velocity,), (jnp.ones_like(zero),))


def joined(
    before: PlantState, drive: tuple[DriveState, DriveOutput], bodies: tuple[BodyState, BodyOutput]
) -> tuple[PlantState, PlantOutput]:
    """The plant after a period in which its two halves moved as given."""
    (drive_state, drive_output), (body_state, body_output) = drive, bodies
    force, memory = body_output.contact_force, before.sensor_memory
    after = PlantState(body_state, drive_state, drive_output.end_torque, force, memory)
    return after, PlantOutput(drive_output, body_output)


def link_motion(state: PlantState) -> JointMotion:
    """The links seen by their drives.

    The load of each bearing of a leg is taken as the size of the leg's whole contact force: its part along the axis
    counts, weight and inertia of the links do not.
    """
    q, u = state.bodies.q, state.bodies.u
    load = jnp.repeat(jnp.sqrt((state.contact_force**2).sum(-1) + 1e-6), 3)
    return JointMotion(q[7:], u[6:], jnp.zeros_like(load), load)


def make_plant(model: Model, drive: str = "full", library: dict[str, Effect] = LIBRARY, **bodies_options: Any) -> Plant:
    """The plant of a model with one of the drives `full`, `cheap` or `ideal`. Raises UserError."""
    if drive not in DRIVES:
        raise UserError(f"No drive '{drive}'; choose one of {', '.join(DRIVES)}.")
    if model.numbers is None:
        raise UserError(
            "This model is a single joint on a bench: it has no legs to simulate; give a model of the robot."
        )
    numbers = model.numbers.model_dump(mode="json")
    periods = periods_from_numbers(numbers)
    # written out for this robot: a quarter of the time and of the compile time of MJX's general tree
    bodies = make_bodies(model.numbers, **({"period": periods.control, "dynamics": "legs"} | bodies_options))
    effects, effect_numbers, placements = activate(model.effects, library)
    params = PlantParams(params_from_numbers(numbers), bodies.params, effect_numbers)
    return Plant(bodies, drive, DRIVES[drive], periods, effects, params, model.numbers, placements)
