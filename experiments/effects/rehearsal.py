"""A user's equations tried once on the robot's own numbers: what fails, or is not off at zero, is refused by name."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.effects.effect import DRIVE_HOOKS, ONE_PLACE, Effect
from mjx_starleth.body_types import nominal_params
from mjx_starleth.names import JOINT_NAMES, LEGS
from mjx_starleth.numbers import load_numbers
from sea_jax import (
    Friction,
    JointCommand,
    JointMeasurement,
    JointMotion,
    Signals,
    Timing,
    params_from_numbers,
    periods_from_numbers,
)

Array = jax.Array

# They know of nothing but their value (see HOOKS).
BLIND = frozenset("drive_parameters body_parameters measured_motion replay_timing loop_timing torso_force".split())


def refuse_faulty(effect: Effect) -> None:
    """Raise ValueError, in words, if an equation fails, returns another form, NaN or infinity, or acts at zero
    strength; and if a strength has no size to start from."""
    for parameter in effect.strengths:
        if parameter.start == 0.0:
            raise ValueError(f"effect {effect.name}: {parameter.name} starts at 0; give the size that is plausible")
    values = _values()
    for hook in effect.equations:
        value, where = values[hook], f"effect {effect.name}, equation at {hook}"
        off, on = (_called(effect, hook, value, size, where) for size in ("off", "start"))
        for found in (off, on):
            if not _alike(found, value):
                raise ValueError(f"{where}: it must return what it got, a {_shape(value)}, not {_shape(found)}")
            if not _as_finite(found, value):
                raise ValueError(f"{where}: with its parameters at their start or at zero it returns NaN or infinity")
        if not _equal(off, value):
            raise ValueError(f"{where}: with its strengths at zero it must return what it got, to the bit")
        if hook == "measurement" and not effect.memory:
            nothing, opposite = (
                _called(effect, hook, value._replace(torque=factor * value.torque), "start", where).torque
                for factor in (0.0, -1.0)
            )
            if not np.allclose(on.torque - nothing, nothing - opposite, rtol=1e-3, atol=1e-4):
                raise ValueError(f"{where}: the torque that it shows must be a straight line in the true torque")


def _called(effect: Effect, hook: str, value: Any, size: str, where: str) -> Any:
    """What the equation at a hook makes of a value, all its parameters at `off` or at `start`."""
    places = () if effect.axis in ONE_PLACE else (len(LEGS if effect.axis == "foot" else JOINT_NAMES),)
    p = SimpleNamespace(**{one.name: jnp.full(places, getattr(one, size), jnp.float32) for one in effect.parameters})
    signals = None if hook in BLIND else _signals()
    remembers = effect.memory > 0 and hook in DRIVE_HOOKS
    memory = (jnp.zeros((len(JOINT_NAMES), effect.memory), jnp.float32),) if remembers else ()
    try:
        found = effect.equations[hook](p, value, signals, *memory)
    except Exception as error:
        raise ValueError(f"{where}: it fails with {type(error).__name__}: {error}") from error
    if not remembers:
        return found
    if not isinstance(found, tuple) or len(found) != 2 or not _alike(found[1], memory[0]):
        raise ValueError(f"{where}: an equation with memory must return (value, memory {memory[0].shape})")
    return found[0]


def _alike(found: Any, value: Any) -> bool:
    """Whether two trees of arrays have the same form; a single number may become one per foot."""
    if jax.tree.structure(found) != jax.tree.structure(value):
        return False
    pairs = zip(map(np.shape, jax.tree.leaves(found)), map(np.shape, jax.tree.leaves(value)), strict=True)
    return all(new == old or (old == () and new == (len(LEGS),)) for new, old in pairs)


def _as_finite(found: Any, value: Any) -> bool:
    """Whether of two trees that are alike one is finite wherever the other is, and nowhere NaN."""
    pairs = zip(jax.tree.leaves(found), jax.tree.leaves(value), strict=True)
    return not any((np.isnan(new) | np.isfinite(old) & ~np.isfinite(new)).any() for new, old in pairs)


def _equal(found: Any, value: Any) -> bool:
    """Whether two trees that are alike hold the same numbers."""
    return all(jax.tree.leaves(jax.tree.map(lambda new, old: bool(np.all(np.equal(new, old))), found, value)))


def _shape(value: Any) -> str:
    """A value in a message."""
    return str(np.shape(value)) if isinstance(value, jax.Array | np.ndarray) else type(value).__name__


def _spread(size: float) -> Array:
    """One value for each joint, of both signs, none of them zero."""
    return jnp.asarray(np.linspace(-size, size, len(JOINT_NAMES), dtype=np.float32))


def _signals() -> Signals:
    """Moving joints under load, as the equations of a drive see them."""
    of_motor = dict(motor_position=_spread(0.8), motor_velocity=_spread(3.0), current=_spread(2.0))
    of_joint = dict(joint_position=_spread(0.7), joint_velocity=_spread(2.5), radial_load=jnp.abs(_spread(100.0)))
    of_spring = dict(deflection=_spread(0.1), deflection_rate=_spread(0.5), spring_torque=_spread(10.0))
    return Signals(winding_voltage=_spread(10.0), period=jnp.float32(1e-4), **of_motor, **of_joint, **of_spring)


def _values() -> dict[str, Any]:
    """What the equations at each hook get."""
    numbers = load_numbers()
    dump = numbers.model_dump(mode="json")
    drive, still = params_from_numbers(dump), jnp.zeros(len(JOINT_NAMES), jnp.float32)
    motion = JointMotion(_spread(0.7), _spread(2.5), _spread(20.0), jnp.abs(_spread(100.0)))
    timing = Timing(still + 0.5 * periods_from_numbers(dump).velocity, still, still, still)
    return {
        "drive_parameters": drive,
        "body_parameters": jax.tree.map(jnp.asarray, nominal_params(numbers)),
        "command": JointCommand(_spread(10.0), _spread(0.7), still),
        "measurement": JointMeasurement(_spread(0.7), _spread(2.5), _spread(10.0), _spread(0.8)),
        "measured_motion": motion,
        "replay_timing": timing,
        "loop_timing": timing,
        "commanded_velocity": _spread(3.0),
        "supply_voltage": drive.bus_voltage,
        "motor_torque": _spread(0.1),
        "friction": Friction(drive.friction_coulomb, _spread(0.01)),
        "deflection": _spread(0.1),
        "spring": _spread(10.0),
        "joint_drag": _spread(0.5),
        "torso_force": jnp.asarray([1.0, -2.0, 3.0], jnp.float32),
    }
