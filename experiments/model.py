"""`model.json`: the nominal numbers of the robot and the effects that were found to be missing. One model, one truth.

Every command takes such a file; with an empty list of effects it is the paper's model. A bare numbers file in the
form of `mjx_starleth/starleth.json` is read as a model without effects.
"""

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat, ValidationError

from experiments.effects.bench import bench_effects, elastic_effects
from experiments.effects.effect import Effect
from experiments.effects.library import LIBRARY, find_effect
from experiments.effects.places import mask
from experiments.errors import UserError
from experiments.files import Strict, first_complaint, read_json, shown, write_json
from mjx_starleth.names import JOINT_NAMES
from mjx_starleth.numbers import RobotNumbers, load_numbers

SCHEMA_VERSION = 1
MAX_BYTES = 4_000_000


class FittedValue(Strict):
    """A number with its 95 % interval where it was fitted."""

    value: FiniteFloat
    ci95: tuple[FiniteFloat, FiniteFloat] | None = None
    unit: str = ""


class PlacedEffect(Strict):
    """An effect of the library (or of a user's file), where it acts, and its parameters."""

    effect: Annotated[str, Field(max_length=80)]
    where: Annotated[str, Field(max_length=40)]
    parameters: dict[str, FittedValue]

    def values(self) -> dict[str, float]:
        """Parameter values by name."""
        return {name: fitted.value for name, fitted in self.parameters.items()}


class JointNumbers(Strict):
    """A single joint on a bench (LOGS: `robot: joint`)."""

    name: str
    kind: Literal["revolute", "prismatic"]
    inertia: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    viscous_friction: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    gravity_load: FiniteFloat = 0.0
    drive: Literal["rigid", "HAA", "HFE", "KFE"] = "rigid"  # or the joint kind whose series-elastic drive turns it


class Model(Strict):
    """The contents of a model file."""

    schema_version: Literal[1] = SCHEMA_VERSION
    robot: Literal["starleth", "joint"] = "starleth"
    numbers: RobotNumbers | None = None
    joint: JointNumbers | None = None
    effects: tuple[PlacedEffect, ...] = ()
    provenance: tuple[dict[str, Any], ...] = ()

    @property
    def joint_names(self) -> tuple[str, ...]:
        return JOINT_NAMES if self.joint is None else (self.joint.name,)

    def hash(self) -> str:
        """What the robot is, in 16 hexadecimal digits: numbers and effects; not prose, provenance or intervals."""
        numbers = self.numbers.model_dump(mode="json", exclude={"about", "sources"}) if self.numbers else None
        identity = {
            "numbers": numbers,
            "joint": self.joint.model_dump(mode="json") if self.joint else None,
            "effects": [(e.effect, e.where, sorted(e.values().items())) for e in self.effects],
        }
        return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]

    def with_effect(self, placed: PlacedEffect, source: dict[str, Any] | None = None) -> "Model":
        """This model with one more effect, in place of the same one there; where its places overlap, this one rules."""
        others = tuple(e for e in self.effects if (e.effect, e.where) != (placed.effect, placed.where))
        provenance = self.provenance + ((source,) if source else ())
        return self.model_copy(update={"effects": (*others, placed), "provenance": provenance})


def nominal_model() -> Model:
    """StarlETH with its nominal numbers and no effects."""
    return Model(numbers=load_numbers())


def load_model(path: Path | None, effects: dict[str, Effect] = LIBRARY) -> Model:
    """The model in a file, or the nominal one for None. Raises UserError."""
    if path is None:
        return nominal_model()
    content = read_json(Path(path), MAX_BYTES)
    if not isinstance(content, dict):
        raise UserError(f"{shown(path)} is not a model file: it must hold a JSON object.")
    if "bodies" in content and "drive" in content:
        content = {"schema_version": SCHEMA_VERSION, "numbers": content}
    if "schema_version" not in content:
        raise UserError(
            f"{shown(path)} is neither a model file nor a robot's numbers; give one that `starleth learn` wrote, or "
            "numbers in the form of mjx_starleth/starleth.json."
        )
    if content["schema_version"] != SCHEMA_VERSION:
        raise UserError(
            f"{shown(path)} has model schema version {shown(str(content['schema_version']))}; this program reads "
            f"{SCHEMA_VERSION}: learn it again with `starleth learn`."
        )
    try:
        model = Model.model_validate(content)
    except ValidationError as error:
        raise UserError(f"{shown(path)}: {first_complaint(error)}; correct it and try again.") from None
    if (model.numbers is None) == (model.joint is None):
        raise UserError(
            f"{shown(path)}: a model holds either 'numbers' (starleth) or 'joint' (a single joint on a bench)."
        )
    if model.joint is not None:
        rigid = model.joint.drive == "rigid"
        effects = bench_effects(effects, model.joint.kind == "prismatic") if rigid else elastic_effects(effects)
    for placed in model.effects:
        _check_effect(placed, find_effect(placed.effect, effects), model.joint_names, path)
    return model


def save_model(path: Path, model: Model) -> None:
    """Write a model file atomically."""
    write_json(Path(path), model.model_dump(mode="json", exclude_none=True))


def _check_effect(placed: PlacedEffect, effect: Effect, joint_names: tuple[str, ...], path: Path) -> None:
    try:
        mask(placed.where, effect.axis, joint_names)
    except ValueError as error:
        raise UserError(f"{shown(path)}: effect {placed.effect}: {error}.") from None
    known = {parameter.name: parameter for parameter in effect.parameters}
    unknown = set(placed.parameters) - set(known)
    if unknown:
        raise UserError(
            f"{shown(path)}: effect {placed.effect} has no parameter '{shown(min(unknown))}'; it has "
            f"{', '.join(known)}."
        )
    for name, value in placed.values().items():
        low, high = known[name].low, known[name].high
        if not low <= value <= high:
            raise UserError(f"{shown(path)}: effect {placed.effect}: {name} = {value} lies outside [{low}, {high}].")
