"""Stages of a search: the same parameters, an ever more faithful cost (paper V.C.1)."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

from es.checks import check_count, check_number


@dataclass(frozen=True)
class Stage:
    """One stage; it begins with the mean and covariance that the stage before it ended with.

    `key` is whatever static thing the caller's `evaluate` needs to know (it reaches it with the stage); its repr goes
    into the checkpoints, so that a resumed search is the same search. On entry sigma is multiplied by `sigma_rescale`
    and then raised until the distribution's longest axis has a standard deviation of `sigma_floor` (normalised).
    Raises ValueError if a number makes no sense or the key's repr changes from run to run.
    """

    name: str
    generations: int
    key: Hashable = None
    sigma_rescale: float = 1.0
    sigma_floor: float = 0.0

    def __post_init__(self) -> None:
        check_count(f"stage '{self.name}': generations", self.generations, at_least=1)
        check_number(f"stage '{self.name}': sigma_rescale", self.sigma_rescale, above=0.0)
        check_number(f"stage '{self.name}': sigma_floor", self.sigma_floor, at_least=0.0)
        if " at 0x" in repr(self.key):
            raise ValueError(
                f"stage '{self.name}': its key has no lasting repr; use a string, a number, a tuple or a dataclass"
            )

    def describe(self) -> dict[str, Any]:
        """Everything that defines the stage as plain JSON values."""
        return {
            "name": self.name,
            "generations": self.generations,
            "key": repr(self.key),
            "sigma_rescale": float(self.sigma_rescale),
            "sigma_floor": float(self.sigma_floor),
        }


def check_stages(stages: Sequence[Stage]) -> tuple[Stage, ...]:
    """The stages as a tuple; ValueError if there is none or two share a name."""
    stages = tuple(stages)
    if not stages:
        raise ValueError("a search needs at least one stage")
    names = [stage.name for stage in stages]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"the stage name '{name}' is used {names.count(name)} times")
    return stages
