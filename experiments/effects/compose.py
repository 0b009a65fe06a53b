"""From placed effects to hooks: spread each parameter over its places and splice the equations into the plant.

The structure (which effects, where) is static; their numbers are arrays, so a fit, a search or a perturbation may
change them without compiling again.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from experiments.effects.effect import DRIVE_HOOKS, ONE_PLACE, Effect
from experiments.effects.places import mask
from mjx_starleth.names import JOINT_NAMES
from sea_jax import DriveHooks

Array = jax.Array
EffectNumbers = tuple[dict[str, Array], ...]

NUMBERS = frozenset({"drive_parameters", "body_parameters"})


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
            if hook in NUMBERS:  # the nominal ones are NumPy's, whose arrays lack `at`
                value = jax.tree.map(jnp.asarray, value)
            value = equation(p, value, signals)
        return value

    def hooks(self, hook: str, numbers: EffectNumbers) -> tuple:
        """The equations at a hook as functions (value, signals, memory) -> (value, memory)."""
        return tuple(_with_memory(effect, equation, p) for effect, equation, p in self._at(hook, numbers))

    def without(self, hook: str, numbers: EffectNumbers) -> tuple["ActiveEffects", EffectNumbers]:
        """Those that have no equation at a hook."""
        left = [(e, values) for e, values in zip(self.effects, numbers, strict=True) if hook not in e.equations]
        return ActiveEffects(tuple(effect for effect, _ in left)), tuple(values for _, values in left)

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


class Placement(NamedTuple):
    """Where one of a model's effects acts. Of two of the same effect that overlap, the one placed last rules there."""

    name: str  # effect@place
    effect: int  # its index in ActiveEffects.effects
    here: np.ndarray  # bool over the effect's axis


def is_on(placed: Any, library: Mapping[str, Effect]) -> bool:
    """Whether any strength of a placed effect differs from zero."""
    values = placed.values()
    return any(values.get(parameter.name, 0.0) != 0.0 for parameter in library[placed.effect].strengths)


def activate(
    placed: Iterable[Any], library: Mapping[str, Effect], joint_names: Sequence[str] = JOINT_NAMES
) -> tuple[ActiveEffects, EffectNumbers, tuple[Placement, ...]]:
    """Static and numeric half of a model's effects, and where each acts. An effect that is off is left out whole, so
    that it changes no bit of a rollout."""
    placed = tuple(placed)
    names = tuple(dict.fromkeys(item.effect for item in placed if is_on(item, library)))
    of_each = [[item for item in placed if item.effect == name] for name in names]
    placements = [
        Placement(f"{item.effect}@{item.where}", index, here)
        for index, items in enumerate(of_each)
        for item, here in zip(items, _reach(library[names[index]], items, joint_names), strict=True)
    ]
    numbers = tuple(_spread(library[name], items, joint_names) for name, items in zip(names, of_each, strict=True))
    return ActiveEffects(tuple(library[name] for name in names)), numbers, tuple(placements)


def _reach(effect: Effect, items: Sequence[Any], joint_names: Sequence[str]) -> list[np.ndarray]:
    """Where each of the placed ones rules: its place without those of the later ones."""
    masks = [mask(item.where, effect.axis, tuple(joint_names)) > 0 for item in items]
    return [here & ~np.any(masks[k + 1 :] or [np.zeros_like(here)], axis=0) for k, here in enumerate(masks)]


def _spread(effect: Effect, items: Sequence[Any], joint_names: Sequence[str]) -> dict[str, Array]:
    """One array per parameter over the effect's axis: its value where it acts, 'off' elsewhere."""
    reach = _reach(effect, items, joint_names)
    found = {}
    for parameter in effect.parameters:
        array = np.full(reach[0].shape, parameter.off, np.float32)
        for item, here in zip(items, reach, strict=True):
            array[here] = item.values().get(parameter.name, parameter.off)
        found[parameter.name] = jnp.asarray(array[0] if effect.axis in ONE_PLACE else array)
    return found
