"""From placed effects to hooks: spread each parameter over its places and splice the equations into the plant.

The structure (which effects, where) is static; their numbers are arrays, so a fit, a search or a perturbation may
change them without compiling again.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.effects.effect import Effect
from experiments.effects.places import mask
from mjx_starleth.names import JOINT_NAMES
from sea_jax import DriveHooks

Array = jax.Array
EffectNumbers = tuple[dict[str, Array], ...]

DRIVE_HOOKS = (
    "command",
    "measurement",
    "commanded_velocity",
    "supply_voltage",
    "motor_torque",
    "friction",
    "deflection",
    "spring",
)


@dataclass(frozen=True)
class ActiveEffects:
    """Effects in the order in which they act on a hook; the static half of what a model adds to the plant."""

    effects: tuple[Effect, ...] = ()

    def _at(self, hook: str, numbers: EffectNumbers):
        for effect, values in zip(self.effects, numbers, strict=True):
            if hook in effect.equations:
                yield effect, effect.equations[hook], SimpleNamespace(**values)

    def apply(self, hook: str, numbers: EffectNumbers, value: Any, signals: Any = None) -> Any:
        """Apply the memoryless equations at a hook to a value, in order, given what they may look at."""
        for _, equation, p in self._at(hook, numbers):
            value = equation(p, value, signals)
        return value

    def hooks(self, hook: str, numbers: EffectNumbers) -> tuple:
        """The equations at a hook as functions (value, signals, memory) -> (value, memory)."""
        return tuple(_with_memory(effect, equation, p) for effect, equation, p in self._at(hook, numbers))

    def drive_hooks(self, numbers: EffectNumbers) -> DriveHooks:
        """What the effects splice into the drive. Sensor effects act in the plant, before any controller."""
        return DriveHooks(**{hook: self.hooks(hook, numbers) for hook in DRIVE_HOOKS if hook != "measurement"})

    def memory(self, joints: int = len(JOINT_NAMES)) -> dict[str, tuple[Array, ...]]:
        """Initial memory of the hooks of the drive."""
        found = {}
        for hook in DRIVE_HOOKS:
            memory = self.memory_at(hook, joints)
            if any(one.size for one in memory):
                found[hook] = memory
        return found

    def memory_at(self, hook: str, joints: int) -> tuple[Array, ...]:
        """Initial memory of the effects at one hook, (joints, memory) each."""
        here = [effect for effect in self.effects if hook in effect.equations]
        return tuple(jnp.zeros((joints, effect.memory), jnp.float32) for effect in here)


def _with_memory(effect: Effect, equation, p):
    if effect.memory:
        return lambda value, signals, memory: equation(p, value, signals, memory)
    return lambda value, signals, memory: (equation(p, value, signals), memory)


def spread(
    effect: Effect, where: str, values: Mapping[str, float], joint_names: Sequence[str] = JOINT_NAMES
) -> dict[str, Array]:
    """One array per parameter over the effect's axis: its value where it acts, 'off' elsewhere."""
    here = mask(where, effect.axis, tuple(joint_names))
    spread_values = {}
    for parameter in effect.parameters:
        value = values.get(parameter.name, parameter.off)
        array = np.where(here > 0, value, parameter.off).astype(np.float32)
        spread_values[parameter.name] = jnp.asarray(array[0] if effect.axis == "torso" else array)
    return spread_values


def is_on(placed: Any, library: Mapping[str, Effect]) -> bool:
    """Whether any strength of a placed effect differs from zero."""
    values = placed.values()
    return any(values.get(parameter.name, 0.0) != 0.0 for parameter in library[placed.effect].strengths)


def activate(
    placed: Iterable[Any], library: Mapping[str, Effect], joint_names: Sequence[str] = JOINT_NAMES
) -> tuple[ActiveEffects, EffectNumbers]:
    """Static and numeric half of a model's effects. An effect that is off is left out whole, so that it changes
    no bit of a rollout."""
    on = [item for item in placed if is_on(item, library)]
    numbers = tuple(spread(library[item.effect], item.where, item.values(), joint_names) for item in on)
    return ActiveEffects(tuple(library[item.effect] for item in on)), numbers
