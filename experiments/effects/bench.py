"""The effects on a single joint: the robot's, and those of the load that it turns.

On a series-elastic drive they are the robot's as they stand. On a rigid one they are its equations with gear 1, in the
joint's own units and sizes: a rigid drive has no spring, no current that is logged and no gear of its own, so an
effect's numbers count at the joint, and what size is plausible follows from the efforts, speeds and travel of the log.
"""

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp

from experiments.effects.effect import Effect, Parameter

FELT_BY_RIGID_JOINT = frozenset("drive_parameters command motor_torque friction joint_drag measured_motion".split())
# on a rigid joint these are the gear's friction by another name
SAME_AS_GEAR = frozenset({"joint_coulomb_drag", "joint_viscous_drag"})
OF_SPRING = frozenset({"spring_stiffness", "spring_damping"})  # numbers of the drive that a rigid one lacks
START, MOST = 0.05, 2.0  # of the natural size: where a strength starts, and how far it may go
SHAPE_START = 0.1
UNBOUNDED = 1e9


class Scale(NamedTuple):
    """What is large on this bench: effort [N m or N], travel [rad or m], speed [rad/s or m/s]."""

    effort: float
    travel: float
    speed: float


class Dimension(NamedTuple):
    """A parameter's unit on a revolute and on a prismatic joint; its powers of effort, travel and speed."""

    revolute: str
    prismatic: str
    effort: int = 0
    travel: int = 0
    speed: int = 0

    def natural(self, scale: Scale) -> float:
        """One natural unit."""
        return scale.effort**self.effort * scale.travel**self.travel * scale.speed**self.speed


_EFFORT = Dimension("N m", "N", effort=1)
_VISCOUS = Dimension("N m s/rad", "N s/m", effort=1, speed=-1)
DIMENSIONS: Mapping[str, Dimension] = {
    "N m": _EFFORT,
    "N m at the rotor": _EFFORT,
    "N m s/rad": _VISCOUS,
    "N m s/rad at the rotor": _VISCOUS,
    "N m at the rotor per rad/s at the gear output": _VISCOUS,
    "N m s^3/rad^3 at the rotor": Dimension("N m s^3/rad^3", "N s^3/m^3", effort=1, speed=-3),
    "rad/s at the gear output": Dimension("rad/s", "m/s", speed=1),
    "rad": Dimension("rad", "m", travel=1),
    "1/A^2": Dimension("1/(N m)^2", "1/N^2", effort=-2),
    "N m at the rotor per N m at the joint": Dimension("1", "1"),
    "periods per turn of the gear output": Dimension("1/rad", "1/m", travel=-1),
}


def _gravity(p, drag, s):
    return drag + p.torque * jnp.sin(s.joint_position)


GRAVITY_LOAD = Effect(
    "gravity_load",
    "the load hangs heavier or lighter on its axis than nominal (its torque at 90 degrees from hanging down)",
    "bodies",
    "joint",
    (Parameter("torque", "N m", -UNBOUNDED, UNBOUNDED, 0.1),),
    {"joint_drag": _gravity},
)


def _load_inertia(p, load, _):
    return load._replace(inertia=load.inertia * (1.0 + p.relative))


LOAD_INERTIA = Effect(
    "load_inertia",
    "the load turns more or less inertia than nominal",
    "bodies",
    "joint",
    (Parameter("relative", "1", -0.8, 4.0, 0.2),),
    {"body_parameters": _load_inertia},
)


def elastic_effects(library: Mapping[str, Effect]) -> dict[str, Effect]:
    """The effects that a joint with a spring of its own can show."""
    able = {name: effect for name, effect in library.items() if effect.axis == "joint"}
    return able | {effect.name: effect for effect in (GRAVITY_LOAD, LOAD_INERTIA)}


def bench_effects(library: Mapping[str, Effect], prismatic: bool) -> dict[str, Effect]:
    """The effects that a rigid joint can show, with units but without sizes: bounds are wide open."""
    able = {n: e for n, e in library.items() if e.axis == "joint" and FELT_BY_RIGID_JOINT & set(e.equations)}
    able = {GRAVITY_LOAD.name: GRAVITY_LOAD} | able
    hidden = SAME_AS_GEAR | OF_SPRING | ({GRAVITY_LOAD.name} if prismatic else set())
    able = {name: effect for name, effect in able.items() if name not in hidden}
    return {name: _with(effect, partial(_open, prismatic)) for name, effect in able.items()}


def sized(
    effects: Mapping[str, Effect], library: Mapping[str, Effect], scale: Scale, viscous: float
) -> dict[str, Effect]:
    """bench_effects with starts and bounds for a log's scale; `viscous` is the nominal viscous friction."""
    found = {}
    for name, effect in effects.items():
        originals = {p.name: p for p in library.get(name, effect).parameters}
        found[name] = _with(effect, partial(_sized, originals, scale, _lowest(name, viscous)))
    return found


def _lowest(effect: str, viscous: float) -> float:
    """Least strength: what the nominal friction can lose."""
    return {"coulomb_friction": 0.0, "viscous_friction": -viscous}.get(effect, -UNBOUNDED)


def _sized(originals: Mapping[str, Parameter], scale: Scale, lowest: float, p: Parameter) -> Parameter:
    original = originals[p.name]
    if original.unit not in DIMENSIONS:
        return p
    natural = DIMENSIONS[original.unit].natural(scale)
    if p.role == "shape":
        ratio = SHAPE_START * natural / original.start
        return dataclasses.replace(
            p, low=original.low * ratio, high=original.high * ratio, start=original.start * ratio
        )
    low = max(-MOST * natural, lowest) if original.low < 0 else 0.0
    start = START * natural if original.start >= 0 else -START * natural
    return dataclasses.replace(p, low=low, high=MOST * natural, start=max(start, low))


def _open(prismatic: bool, p: Parameter) -> Parameter:
    dimension = DIMENSIONS.get(p.unit)
    if dimension is None:
        return p
    unit = dimension.prismatic if prismatic else dimension.revolute
    return dataclasses.replace(p, unit=unit, low=0.0 if p.low >= 0 else -UNBOUNDED, high=UNBOUNDED)


def _with(effect: Effect, change: Callable[[Parameter], Parameter]) -> Effect:
    return dataclasses.replace(effect, parameters=tuple(change(p) for p in effect.parameters))
