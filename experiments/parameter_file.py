"""`parameters.json`: a motion's parameters for the robot's controller, with all it takes to trust them.

`ParameterFile` is the schema of record; `schemas/parameters.schema.json` is generated from it for other
languages (`python -m experiments.parameter_file > experiments/schemas/parameters.schema.json`). The
checksum is SHA-256 over the canonical form (RFC 8785: keys sorted, no spaces, numbers as in ECMAScript) of
the file without its key `checksum`, so that a reader in any language can verify it.
"""

import hashlib
import json
import math
import struct
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import rfc8785
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from experiments.errors import UserError
from experiments.files import first_complaint, read_json, shown, write_json
from experiments.robustness.statistics import success_interval

SCHEMA_VERSION: Final = 2
SCHEMA_ID: Final = "starleth:parameters.schema.json"
MAX_BYTES: Final = 1_000_000  # a file with every optional part has some 10 kB

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_.@/:\-]*$", max_length=100)]
# may name a file: no dots, no slashes
Word = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_\-]*$", max_length=100)]
Line = Annotated[str, Field(max_length=2000)]
Count = Annotated[int, Field(ge=0, lt=2**53)]  # JSON numbers are doubles for most readers
Share = Annotated[float, Field(ge=0, le=1)]


class _Record(BaseModel):
    """Strict: no unknown keys, no text for numbers, no NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Parameter(_Record):
    """One number of the motion, inside its bounds."""

    name: Name
    value: float
    unit: Annotated[str, Field(max_length=40, description="SI; '-' for a pure number")]
    low: float
    high: float

    @model_validator(mode="after")
    def _inside(self) -> Self:
        if not self.low <= self.value <= self.high:
            raise ValueError(f"{self.name} = {self.value:g} {self.unit} lies outside [{self.low:g}, {self.high:g}]")
        return self


class Spread(_Record):
    """How a metric varies over the perturbed trials; for a yes-or-no metric yes counts 1."""

    mean: float
    std: Annotated[float, Field(ge=0)]
    low: float = Field(description="smallest")
    high: float = Field(description="largest")


class Metric(_Record):
    """A figure of the nominal motion, and its spread over perturbed trials where those were run."""

    value: bool | float
    unit: Annotated[str, Field(max_length=40)]
    spread: Spread | None = None


class PerturbedTrials(_Record):
    """What the spreads were taken over."""

    trials: Count
    seed: Count
    perturbations: dict[Name, Line] = Field(description="what was perturbed, and by how much")


class RobustnessGate(_Record):
    """Did enough perturbed trials succeed to let the robot try?

    Passed where the lower end of `ci95` reaches `required`: a few lucky trials prove nothing.
    """

    required: Share
    passed: bool
    success_rate: Share
    ci95: Annotated[list[Share], Field(min_length=2, max_length=2, description="of the success rate, Clopper-Pearson")]
    trials: Annotated[Count, Field(ge=1)]
    seed: Count
    perturbations: dict[Name, Line] = Field(description="what was perturbed, and by how much")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.passed != (self.ci95[0] >= self.required):
            raise ValueError("passed contradicts ci95 and required")
        if not self.ci95[0] <= self.success_rate <= self.ci95[1]:
            raise ValueError("success_rate lies outside ci95")
        return self


class ParameterFile(_Record):
    """Parameters of a motion for StarlETH's locomotion controller. SI units, radians."""

    schema_version: Literal[2] = SCHEMA_VERSION
    task: Word
    # optional: files of the same schema version were written before it was recorded
    task_hash: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")] | None = Field(
        default=None, description="of what a replay of the task depends on; null: not recorded"
    )
    robot: Word
    model_hash: Annotated[str, Field(pattern=r"^[0-9a-f]{16,64}$", description="of the model it was tuned on")]
    parameters: Annotated[list[Parameter], Field(min_length=1, max_length=1000)]
    metrics: dict[Name, Metric]
    cost_terms: dict[Name, float] = Field(description="what the cost is the sum of, weights included")
    perturbed: PerturbedTrials | None = None
    robustness_gate: RobustnessGate | None = Field(default=None, description="null: not run")
    drive: Word
    seed: Count
    search: dict[Name, bool | int | float | Line] = Field(description="generations, population, stages, …")
    versions: dict[Name, Line]
    created: Annotated[str, Field(pattern=r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ$", description="UTC")]
    command: Line = Field(description="replays the motion")
    checksum: Annotated[
        str,
        Field(
            pattern=r"^[0-9a-f]{64}$",
            description="SHA-256 of the RFC 8785 form of this file without the key checksum",
        ),
    ]

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        names = [parameter.name for parameter in self.parameters]
        if len(set(names)) != len(names):
            raise ValueError("a parameter stands in it twice")
        return self

    def values(self) -> dict[str, float]:
        """Parameter values by name, in the file's order."""
        return {parameter.name: parameter.value for parameter in self.parameters}


def parameter(name: str, value: float, unit: str, low: float, high: float) -> Parameter:
    """A parameter from a float32 search, whose rounding may put it one unit in the last place past its bound.

    Raises ValueError when it lies further outside than that.
    """
    nearest = min(max(value, low), high)
    same_float32 = math.isfinite(value) and struct.pack("f", value) == struct.pack("f", nearest)
    return Parameter(name=name, value=nearest if same_float32 else value, unit=unit, low=low, high=high)


def gate(required: float, successes: int, trials: int, seed: int, perturbations: dict[str, str]) -> RobustnessGate:
    """The verdict on so many trials."""
    low, high = success_interval(successes, trials)
    return RobustnessGate(
        required=required,
        passed=low >= required,
        success_rate=successes / trials,
        ci95=[low, high],
        trials=trials,
        seed=seed,
        perturbations=perturbations,
    )


def now() -> str:
    """The time as it stands in `created`."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def checksum(content: dict[str, Any]) -> str:
    """SHA-256 of the canonical form of the content without its key `checksum`. Raises ValueError (NaN, …)."""
    rest = {key: value for key, value in content.items() if key != "checksum"}
    return hashlib.sha256(rfc8785.dumps(rest)).hexdigest()


def write_parameters(path: Path | str, **fields: Any) -> ParameterFile:
    """Write the fields of `ParameterFile` (all but `schema_version` and `checksum`) atomically; returns the
    file.

    Raises UserError: the disk is full, the folder cannot be written, a number is NaN or out of its bounds.
    """
    try:
        unsigned = ParameterFile(checksum="0" * 64, **fields).model_dump(mode="json")
    except ValidationError as error:
        raise UserError(f"{shown(path)} was not written: {first_complaint(error)}.") from None
    content = unsigned | {"checksum": checksum(unsigned)}
    write_json(path, content)
    return ParameterFile.model_validate(content)


def read_parameters(
    path: Path | str,
    *,
    robot: str | None = None,
    model_hash: str | None = None,
    task: str | None = None,
    allow_ungated: bool = False,
) -> ParameterFile:
    """Read a parameter file, or refuse it with a UserError of one sentence.

    Refused: a file that is damaged or incomplete, of another schema version, of another robot, model or
    task than asked for, with a value out of bounds, or that has not passed a robustness gate (unless
    `allow_ungated`: for simulation, or by a user who knows).
    """
    content = read_json(path, MAX_BYTES)
    name = shown(path)
    if not isinstance(content, dict) or "schema_version" not in content or "parameters" not in content:
        raise UserError(f"{name} is not a parameter file; give a parameters.json that 'starleth tune' wrote.")
    if content["schema_version"] != SCHEMA_VERSION or type(content["schema_version"]) is not int:
        raise UserError(
            f"{name} has schema version {shown(str(content['schema_version']))}, and this program reads "
            f"{SCHEMA_VERSION}; tune again or use the version of starleth that wrote it."
        )
    try:
        file = ParameterFile.model_validate(content)
        intact = checksum(content) == file.checksum
    except ValidationError as error:
        raise UserError(f"{name} is refused: {first_complaint(error)}; take an undamaged copy or tune again.") from None
    except ValueError as error:  # not representable in RFC 8785
        raise UserError(f"{name} is refused: {error}; take an undamaged copy or tune again.") from None
    if not intact:
        raise UserError(
            f"{name} was changed after it was written (its checksum is wrong); take an undamaged copy or tune again."
        )
    _refuse_other(file, name, robot, model_hash, task)
    if not allow_ungated:
        _refuse_ungated(file, name)
    return file


def _refuse_ungated(file: ParameterFile, name: str) -> None:
    verdict = file.robustness_gate
    if verdict is None:
        raise UserError(
            f"{name} has not been through a robustness gate; run 'starleth robustness {name} --gate 0.99' and take the "
            "file that it writes, or allow ungated files."
        )
    if not verdict.passed:
        raise UserError(
            f"{name} failed its robustness gate ({verdict.success_rate:.1%} of {verdict.trials} trials succeeded, so "
            f"at least {verdict.ci95[0]:.1%} with 95 % confidence; {verdict.required:.1%} required); tune a more "
            "robust motion, or allow ungated files."
        )


def _refuse_other(file: ParameterFile, name: str, robot: str | None, model_hash: str | None, task: str | None) -> None:
    if robot is not None and file.robot != robot:
        raise UserError(f"{name} is for the robot '{file.robot}', not for '{robot}'; tune for this robot.")
    if model_hash is not None and file.model_hash != model_hash:
        raise UserError(
            f"{name} was tuned on the model {file.model_hash}, not on the model in use, {model_hash}; "
            "give the model file it was tuned on, or tune again."
        )
    if task is not None and file.task != task:
        raise UserError(f"{name} is for the task '{file.task}', not for '{task}'; give the file of that task.")


def json_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of the file, from the model."""
    schema = ParameterFile.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": SCHEMA_ID} | schema


if __name__ == "__main__":
    print(json.dumps(json_schema(), indent=1, ensure_ascii=False))
