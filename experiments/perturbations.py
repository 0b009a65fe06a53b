"""From what distributions the numbers of perturbed trials are drawn: a readable file, and the drawing itself."""

from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from experiments.errors import UserError
from experiments.files import read_json
from experiments.model import Model
from experiments.trial import DISTURBANCES, NOISE_ROWS, PERTURBATIONS

MAX_BYTES = 1_000_000


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Uniform(_Strict):
    """Every value between low and high alike."""

    law: Literal["uniform"]
    low: FiniteFloat
    high: FiniteFloat

    def draw(self, unit: np.ndarray, normal: np.ndarray) -> np.ndarray:
        return self.low + (self.high - self.low) * unit


class Normal(_Strict):
    """A bell around mean, cut at three standard deviations."""

    law: Literal["normal"]
    mean: FiniteFloat
    std: Annotated[float, Field(ge=0, allow_inf_nan=False)]

    def draw(self, unit: np.ndarray, normal: np.ndarray) -> np.ndarray:
        return self.mean + self.std * np.clip(normal, -3.0, 3.0)


class Fixed(_Strict):
    """Always the same value."""

    law: Literal["fixed"]
    value: FiniteFloat

    def draw(self, unit: np.ndarray, normal: np.ndarray) -> np.ndarray:
        return np.full_like(unit, self.value)


Law = Annotated[Uniform | Normal | Fixed, Field(discriminator="law")]


class Perturbations(_Strict):
    """The contents of a perturbation file: name of a number of the plant or a disturbance -> its law."""

    about: str = ""
    draw: dict[str, Law]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.draw)

    def columns(self, key: jax.Array, trials: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Numbers (trials,) by name and the row (trials,) at which each trial's sensor noise starts.

        A trial's numbers depend on the key, its index and the name only, never on how many trials there are.
        """
        found = {}
        for index, (name, law) in enumerate(self.draw.items()):
            unit, normal = _draws(jax.random.fold_in(key, index), trials)
            found[name] = law.draw(unit, normal).astype(np.float32)
        unit, _ = _draws(jax.random.fold_in(key, 1_000_003), trials)
        return found, (unit * NOISE_ROWS).astype(np.int32)


def _draws(key: jax.Array, trials: int) -> tuple[np.ndarray, np.ndarray]:
    keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(jnp.arange(trials))
    unit = jax.vmap(lambda k: jax.random.uniform(k))(keys)
    normal = jax.vmap(lambda k: jax.random.normal(jax.random.fold_in(k, 1)))(keys)
    return np.asarray(unit, np.float64), np.asarray(normal, np.float64)


def load_perturbations(path: Path | None, model: Model) -> Perturbations:
    """The perturbations of a file, or the defaults for None. Raises UserError."""
    if path is None:
        with resources.as_file(resources.files("experiments") / "perturbations.json") as default:
            return parse_perturbations(read_json(default, MAX_BYTES), "the default perturbations", model)
    return parse_perturbations(read_json(Path(path), MAX_BYTES), str(path), model)


def parse_perturbations(content: object, source: str, model: Model) -> Perturbations:
    """Check the content of a perturbation file. Raises UserError naming the key."""
    try:
        perturbations = Perturbations.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the file"
        raise UserError(f"{source}: {place}: {first['msg']}.") from None
    known = known_names(model)
    for name in perturbations.names:
        if name not in known:
            raise UserError(f"{source}: nothing is called '{name}'; the names are {', '.join(known)}.")
    return perturbations


def known_names(model: Model) -> Sequence[str]:
    """Every name that a perturbation may have with this model, its uncertain effects included."""
    effects = [f"{e.effect}@{e.where}.{name}" for e in model.effects for name in e.parameters]
    return (*PERTURBATIONS, *DISTURBANCES, *effects)


def nominal_columns(names: Sequence[str], model: Model) -> Mapping[str, float]:
    """The value of each name at which nothing is off."""
    values = {f"{e.effect}@{e.where}.{n}": v for e in model.effects for n, v in e.values().items()}
    values |= {name: p.nominal for name, p in PERTURBATIONS.items()}
    values |= {name: d[1] for name, d in DISTURBANCES.items()}
    return {name: values[name] for name in names}
