"""The schema of `parameters.json`: a motion's parameters for the robot's controller, with all it takes to trust them.

`ParameterFile` is the schema of record; `schemas/parameters.schema.json` is generated from it for other
languages (`python -m experiments.parameter_schema > experiments/schemas/parameters.schema.json`).
"""

import json
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

SCHEMA_VERSION: Final = 2
SCHEMA_ID: Final = "starleth:parameters.schema.json"

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_.@/:\-]*$", max_length=100)]
# may name a file: no dots, no slashes
Word = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_\-]*$", max_length=100)]
Line = Annotated[str, Field(max_length=2000)]
Count = Annotated[int, Field(ge=0, lt=2**53)]  # JSON numbers are doubles for most readers
Share = Annotated[float, Field(ge=0, le=1)]


class Record(BaseModel):
    """Strict: no unknown keys, no text for numbers, no NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Parameter(Record):
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


class Spread(Record):
    """How a metric varies over the perturbed trials; for a yes-or-no metric yes counts 1."""

    mean: float
    std: Annotated[float, Field(ge=0)]
    low: float = Field(description="smallest")
    high: float = Field(description="largest")


class Metric(Record):
    """A figure of the nominal motion, and its spread over perturbed trials where those were run."""

    value: bool | float
    unit: Annotated[str, Field(max_length=40)]
    spread: Spread | None = None


class PerturbedTrials(Record):
    """What the spreads were taken over."""

    trials: Count
    seed: Count
    perturbations: dict[Name, Line] = Field(description="what was perturbed, and by how much")


class RobustnessGate(Record):
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


class ParameterFile(Record):
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


def json_schema(record: type[Record], name: str) -> dict[str, Any]:
    """JSON Schema (2020-12) of a record's files, published under a name."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": name} | record.model_json_schema()


if __name__ == "__main__":
    print(json.dumps(json_schema(ParameterFile, SCHEMA_ID), indent=1, ensure_ascii=False))
