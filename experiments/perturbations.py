"""From what distributions the numbers of perturbed trials are drawn: a readable file, and the drawing itself."""

import os
import zlib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field, FiniteFloat, ValidationError, model_validator
from scipy.special import ndtr, ndtri

from experiments.effects.compose import is_on
from experiments.effects.effect import Effect
from experiments.effects.library import LIBRARY
from experiments.effects.places import mask
from experiments.errors import UserError
from experiments.files import Strict, first_complaint, read_json, shown
from experiments.model import FittedValue, Model, PlacedEffect
from experiments.tasks.definition import TaskDefinition
from experiments.trial import DISTURBANCES, NOISE_ROWS, PERTURBATIONS

MAX_BYTES = 1_000_000
MAX_NAMES = 200  # every one costs memory and time in each of thousands of trials
CUT = 3.0  # standard deviations at which a bell is cut
SHIPPED: Mapping[str, str] = {"well_kept": "perturbations.json", "rough": "perturbations_rough.json"}


class Uniform(Strict):
    """Every value between low and high alike."""

    law: Literal["uniform"]
    low: FiniteFloat
    high: FiniteFloat

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low = {self.low:g} lies above high = {self.high:g}")
        return self

    @property
    def range(self) -> tuple[float, float]:
        return self.low, self.high

    def draw(self, unit: np.ndarray) -> np.ndarray:
        return self.low + (self.high - self.low) * unit


class Normal(Strict):
    """A bell around mean, cut at three standard deviations."""

    law: Literal["normal"]
    mean: FiniteFloat
    std: Annotated[float, Field(ge=0, allow_inf_nan=False)]

    @property
    def range(self) -> tuple[float, float]:
        return self.mean - CUT * self.std, self.mean + CUT * self.std

    def draw(self, unit: np.ndarray) -> np.ndarray:
        low, high = ndtr(-CUT), ndtr(CUT)
        return self.mean + self.std * ndtri(low + (high - low) * unit)


class Fixed(Strict):
    """Always the same value."""

    law: Literal["fixed"]
    value: FiniteFloat

    @property
    def range(self) -> tuple[float, float]:
        return self.value, self.value

    def draw(self, unit: np.ndarray) -> np.ndarray:
        return np.full_like(unit, self.value)


Law = Annotated[Uniform | Normal | Fixed, Field(discriminator="law")]


class Perturbations(Strict):
    """The contents of a perturbation file: name of a number of the plant or a disturbance -> its law."""

    about: str = ""
    draw: Annotated[dict[str, Law], Field(max_length=MAX_NAMES)]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.draw)

    def columns(self, key: jax.Array, trials: int, first: int = 0) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Numbers (trials,) by name and the row (trials,) at which each trial's sensor noise starts.

        A trial's numbers depend on the key, its index and the name only, never on how many trials there are, on
        `first`, the index of the first one wanted, or on what else is perturbed.
        """
        indices = jnp.arange(first, first + trials, dtype=jnp.uint32)
        found = {}
        for name, law in self.draw.items():
            found[name] = law.draw(_draws(key, name, indices)).astype(np.float32)
        return found, (_draws(key, "the start of the sensor noise", indices) * NOISE_ROWS).astype(np.int32)

    def on(self, model: Model, library: Mapping[str, Effect] = LIBRARY) -> Model:
        """The model with room for every perturbed effect: those that it lacks, or has at zero, switched on.

        Their numbers come from the trials; this model's values for them mean nothing.
        """
        for name in self.names:
            if "@" not in name:
                continue
            effect, where, parameter = split_name(name)
            placed = next((e for e in model.effects if (e.effect, e.where) == (effect, where)), None)
            values = {p.name: p.off for p in library[effect].parameters} | (placed.values() if placed else {})
            if not any(values[p.name] for p in library[effect].strengths):
                values |= {p.name: p.start for p in library[effect].strengths if p.name == parameter}
                fitted = {n: FittedValue(value=v) for n, v in values.items()}
                model = model.with_effect(PlacedEffect(effect=effect, where=where, parameters=fitted))
        return model


@jax.jit
def _keyed_draws(key: jax.Array, indices: jax.Array) -> jax.Array:
    return jax.vmap(lambda i: jax.random.uniform(jax.random.fold_in(key, i)))(indices)


def _draws(key: jax.Array, name: str, indices: jax.Array) -> np.ndarray:
    """Even numbers (trials,) from 0 to below 1."""
    return np.asarray(_keyed_draws(jax.random.fold_in(key, zlib.crc32(name.encode())), indices), np.float64)


def load_perturbations(
    name_or_file: str | Path | None, model: Model, library: Mapping[str, Effect] = LIBRARY
) -> Perturbations:
    """Perturbations by name (see SHIPPED) or from a file; None is `well_kept`. Raises UserError."""
    name = "well_kept" if name_or_file is None else str(name_or_file)
    if name in SHIPPED:
        with resources.as_file(resources.files("experiments") / SHIPPED[name]) as default:
            return parse_perturbations(read_json(default, MAX_BYTES), f"the perturbations '{name}'", model, library)
    if not os.path.exists(name):  # Path.exists raises for a name too long
        raise UserError(f"No perturbations '{shown(name)}'; choose {' or '.join(SHIPPED)}, or give a .json file.")
    return parse_perturbations(read_json(Path(name), MAX_BYTES), shown(name), model, library)


def perturbations_of_task(
    definition: TaskDefinition, name_or_file: str | Path | None, model: Model, library: Mapping[str, Effect] = LIBRARY
) -> Perturbations:
    """Those asked for, else the task's own, else `well_kept`. Raises UserError."""
    if name_or_file is None and definition.perturbations:
        return parse_perturbations(definition.perturbations, f"the perturbations of {definition.task}", model, library)
    return load_perturbations(name_or_file, model, library)


def perturbations_of_search(
    definition: TaskDefinition, name_or_file: str | Path | None, model: Model, library: Mapping[str, Effect] = LIBRARY
) -> Perturbations:
    """What the candidates of a search meet: those asked for, else the task's own with its harder laws for searching.

    Raises UserError.
    """
    own = perturbations_of_task(definition, name_or_file, model, library)
    harder = definition.search_perturbations
    if name_or_file is not None or not harder:
        return own
    if unknown := sorted(set(harder) - set(own.names)):
        raise UserError(
            f"Task {definition.task}: search_perturbations only makes perturbations harder that the task has; "
            f"correct '{shown(unknown[0])}'."
        )
    content = {**definition.perturbations, "draw": {**definition.perturbations["draw"], **harder}}
    return parse_perturbations(content, f"the search_perturbations of {definition.task}", model, library)


def parse_perturbations(
    content: object, source: str, model: Model, library: Mapping[str, Effect] = LIBRARY
) -> Perturbations:
    """Check the content of a perturbation file. Raises UserError naming the key."""
    try:
        perturbations = Perturbations.model_validate(content)
    except ValidationError as error:
        raise UserError(f"{source}: {first_complaint(error)}.") from None
    for name, law in perturbations.draw.items():
        try:
            number = describe(name, model, library)
        except ValueError as error:
            raise UserError(f"{source}: {error}.") from None
        low, high = law.range
        if not number.low <= low <= high <= number.high:
            raise UserError(
                f"{source}: {name} may be {low:g} to {high:g} {number.unit}, which leaves the possible range "
                f"{number.low:g} to {number.high:g}; narrow its law."
            )
    perturbed = {name.rpartition(".")[0] for name in perturbations.names if "@" in name}
    for placed in perturbations.on(model, library).effects:
        if f"{placed.effect}@{placed.where}" in perturbed and not is_on(placed, library):
            raise UserError(
                f"{source}: {placed.effect}@{placed.where} has no strength in this model; perturb one of "
                f"{', '.join(p.name for p in library[placed.effect].strengths)} too."
            )
    return perturbations


class Number(NamedTuple):
    """What a perturbed name stands for."""

    unit: str
    nominal: float  # with this value nothing is off
    low: float
    high: float
    about: str


def describe(name: str, model: Model, library: Mapping[str, Effect] = LIBRARY) -> Number:
    """What a name stands for on this model. Raises ValueError for a name that means nothing."""
    if name in PERTURBATIONS:
        return Number(*PERTURBATIONS[name][:5])
    if name in DISTURBANCES:
        return Number(*DISTURBANCES[name])
    if "@" not in name:
        known = ", ".join((*PERTURBATIONS, *DISTURBANCES))
        raise ValueError(f"nothing is called '{shown(name)}'; the names are {known}, and effect@place.parameter")
    effect, where, parameter = split_name(name)
    if effect not in library:
        raise ValueError(
            f"'{shown(name)}': there is no effect '{effect}'; the effects are {', '.join(sorted(library))}"
        )
    found = {p.name: p for p in library[effect].parameters}
    if parameter not in found:
        raise ValueError(f"'{shown(name)}': effect {effect} has no such parameter; it has {', '.join(found)}")
    mask(where, library[effect].axis)
    p = found[parameter]
    here = [e.values() for e in model.effects if (e.effect, e.where) == (effect, where)]
    return Number(p.unit, here[0].get(parameter, p.off) if here else p.off, p.low, p.high, library[effect].about)


def split_name(name: str) -> tuple[str, str, str]:
    """effect, place and parameter of `effect@place.parameter`; empty strings where something is missing."""
    effect, _, rest = name.partition("@")
    where, _, parameter = rest.rpartition(".")
    return effect, where, parameter


def nominal_columns(names: Sequence[str], model: Model, library: Mapping[str, Effect] = LIBRARY) -> Mapping[str, float]:
    """The value of each name at which nothing is off."""
    return {name: describe(name, model, library).nominal for name in names}
