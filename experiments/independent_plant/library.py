"""Every hidden effect by name, and the effects of a batch turned into families."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from experiments.independent_plant import body_effects, drive_effects, outsiders, signal_effects
from experiments.independent_plant.hooks import Family


def _families(module: object) -> list[type[Family]]:
    return [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, Family)
        and "name" in vars(value)
        and value.__module__ == module.__name__
    ]


FAMILIES: Mapping[str, type[Family]] = {
    family.name: family
    for module in (drive_effects, body_effects, signal_effects, outsiders)
    for family in _families(module)
}
LIBRARY = tuple(name for name, family in FAMILIES.items() if family.library)
OUTSIDERS = tuple(name for name, family in FAMILIES.items() if not family.library)


@dataclass(frozen=True)
class Effect:
    """One hidden effect: its name, where it acts, its parameters in the units of its family."""

    effect: str
    where: str = "all"
    parameters: dict[str, float] = field(default_factory=dict)

    @property
    def family(self) -> type[Family]:
        """Its class. Raises ValueError for a name that no effect has."""
        if self.effect not in FAMILIES:
            raise ValueError(f"no effect {self.effect!r}: there are {', '.join(FAMILIES)}")
        return FAMILIES[self.effect]


def families_of(logs: Sequence[Sequence[Effect]], rngs: Sequence[np.random.Generator]) -> list[Family]:
    """One family per effect name that occurs in a batch, in a fixed order: other effects of sensors falsify what is
    late, not the other way round."""
    families: dict[str, Family] = {}
    for log, effects in enumerate(logs):
        for effect in effects:
            family = families.setdefault(effect.effect, effect.family(len(logs)))
            family.add(log, effect.where, effect.parameters, rngs[log])
    return sorted((families[name] for name in FAMILIES if name in families), key=lambda f: f.name != "sensor_delay")
