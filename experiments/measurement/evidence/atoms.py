"""Atoms: every parameter of every effect at every single joint, link or foot, as one flat vector.

A hypothesis (an effect at a place) moves the atoms of that place together. So one Jacobian over the atoms serves
every effect at every place, and the joint fit of several effects with the robot's nominal numbers.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax
import numpy as np

from experiments.effects.compose import ActiveEffects, EffectNumbers
from experiments.effects.effect import ONE_PLACE, Effect, Parameter
from experiments.effects.places import mask, places_of

AXIS_SIZE = {"link": 12, "foot": 4, "torso": 1, "ground": 1}


class Column(NamedTuple):
    """One parameter of one effect, over its axis."""

    effect: Effect
    parameter: Parameter
    start: int  # first atom
    size: int


@dataclass(frozen=True)
class Atoms:
    """The layout of the flat vector x (n,) for a set of effects on a robot with these joints.

    Equal layouts are equal, so that logs of one robot share their compiled replays.
    """

    effects: tuple[Effect, ...]
    joint_names: tuple[str, ...]

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        found, start = [], 0
        for effect in self.effects:
            size = AXIS_SIZE.get(effect.axis, len(self.joint_names))
            for parameter in effect.parameters:
                found.append(Column(effect, parameter, start, size))
                start += size
        return tuple(found)

    @property
    def size(self) -> int:
        return self.columns[-1].start + self.columns[-1].size if self.columns else 0

    def off(self) -> np.ndarray:
        """x with every effect off, float64."""
        return np.concatenate([np.full(c.size, c.parameter.off) for c in self.columns] or [np.zeros(0)])

    def numbers(self, x: jax.Array) -> EffectNumbers:
        """x as the effects' numbers, for the hooks."""
        of_effect = {effect.name: {} for effect in self.effects}
        for c in self.columns:
            values = x[c.start : c.start + c.size]
            of_effect[c.effect.name][c.parameter.name] = values[0] if c.effect.axis in ONE_PLACE else values
        return tuple(of_effect[effect.name] for effect in self.effects)

    def active(self) -> ActiveEffects:
        """All of the effects, on."""
        return ActiveEffects(self.effects)

    def of(self, effect: str) -> list[Column]:
        """The columns of an effect, in the order of its parameters."""
        return [c for c in self.columns if c.effect.name == effect]

    def touching(self, hooks: frozenset[str]) -> np.ndarray:
        """(n,) True for the atoms of effects that act on any of these hooks."""
        return np.concatenate([np.full(c.size, bool(hooks & set(c.effect.equations))) for c in self.columns])

    def strengths(self) -> np.ndarray:
        """(n,) True for strengths, False for shape parameters."""
        return np.concatenate([np.full(c.size, c.parameter.role == "strength") for c in self.columns])

    def joints_moved(self, direction: np.ndarray, hooks: frozenset[str]) -> np.ndarray:
        """(joints,) True where a change of x acts on any of these hooks; effects that have no joint act on all."""
        moved = np.zeros(len(self.joint_names), bool)
        for c in self.columns:
            if hooks & set(c.effect.equations):
                here = direction[c.start : c.start + c.size] != 0.0
                moved |= here if c.size == len(moved) else here.any()
        return moved

    def places(self, effect: Effect) -> tuple[str, ...]:
        """Where an effect may be looked for; one supply feeds all drives."""
        places = places_of(effect.axis, self.joint_names)
        return places[:1] if "supply_voltage" in effect.equations else places

    def selection(self, effect: str, where: str) -> np.ndarray:
        """(n, parameters): which atoms move when the effect's parameters at a place do."""
        columns = self.of(effect)
        chosen = np.zeros((self.size, len(columns)))
        for k, c in enumerate(columns):
            chosen[c.start : c.start + c.size, k] = mask(where, c.effect.axis, self.joint_names)
        return chosen

    def set(self, x: np.ndarray, effect: str, where: str, values: Mapping[str, float]) -> np.ndarray:
        """A copy of x with an effect's parameters at a place."""
        x = np.array(x, float)
        for c in self.of(effect):
            here = mask(where, c.effect.axis, self.joint_names) > 0
            if c.parameter.name in values:
                x[c.start : c.start + c.size][here] = values[c.parameter.name]
        return x

    def placed(self, x: np.ndarray, placed: Iterable) -> np.ndarray:
        """x with the effects of a model (objects with effect, where, values())."""
        for item in placed:
            x = self.set(x, item.effect, item.where, item.values())
        return x
