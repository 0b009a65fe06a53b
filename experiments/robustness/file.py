"""`robustness.json`: how a motion did over many perturbed trials.

`RobustnessFile` is the schema of record; `schemas/robustness.schema.json` is generated from it for other languages
(`python -m experiments.robustness.file > experiments/schemas/robustness.schema.json`).
"""

import json
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, ValidationError

from experiments.errors import UserError
from experiments.files import first_complaint, read_json, shown
from experiments.parameter_schema import Count, Line, Name, Record, RobustnessGate, Share, Word, json_schema

SCHEMA_VERSION: Final = 1
SCHEMA_ID: Final = "starleth:robustness.schema.json"
MAX_BYTES: Final = 4_000_000

Interval = Annotated[list[Share], Field(min_length=2, max_length=2, description="low, high")]
Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{16,64}$")]


class WorstTrial(Record):
    """A trial that can be run again alone: failures first, then the dearest."""

    trial: Count
    seed: Count
    success: bool
    cost: float
    drawn: dict[Name, float] = Field(description="every perturbed number of this trial")
    metrics: dict[Name, float]
    command: Line = Field(description="runs this trial alone")


class Sensitivity(Record):
    """How much one perturbation decides the cost, the strongest first."""

    name: Name
    unit: str
    share: Share = Field(description="of the variance of the cost's rank that it explains alone")
    direction: Annotated[float, Field(ge=-1, le=1, description="rank correlation with the cost; > 0: more is worse")]
    p_value: Share


class Spread(Record):
    """A figure over the trials."""

    unit: str
    mean: float
    std: Annotated[float, Field(ge=0)]
    low: float
    p05: float
    p50: float
    p95: float
    high: float


class SurvivalCurve(Record):
    """Success in bins of one disturbance."""

    name: Line
    unit: str
    edges: list[float]
    trials: list[Count]
    successes: list[Count]
    ci95: list[Interval]


class RobustnessFile(Record):
    """Success, worst cases, sensitivity and margins of one motion. SI units, radians."""

    schema_version: Literal[1] = SCHEMA_VERSION
    task: Word
    robot: Word
    model_hash: Hash = Field(description="of the model that was perturbed")
    tuned_on: Hash = Field(description="hash of the model that the motion was tuned on")
    parameters: Hash = Field(description="checksum of the parameter file")
    drive: Word
    seed: Count
    trials: Annotated[Count, Field(ge=1)]
    successes: Count
    success_rate: Share
    ci95: Interval = Field(description="Clopper-Pearson")
    gate: RobustnessGate | None = Field(default=None, description="null: not asked for")
    worst: list[WorstTrial]
    sensitivity: list[Sensitivity]
    margins: dict[Name, Spread] = Field(
        description="distance to the nominal robot's limits at the tightest moment of the trials that succeed (of all, "
        "if none does); 0 is at the limit, below it is beyond"
    )
    metrics: dict[Name, Spread]
    survival: list[SurvivalCurve]
    sampled: Count = Field(description="trials, from the first on, that sensitivity, spreads and curves are taken over")
    perturbations: dict[Name, Line] = Field(description="what was drawn, from which law")
    versions: dict[Name, Line]
    created: Annotated[str, Field(pattern=r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ$", description="UTC")]
    command: Line


def read_robustness(path: Path | str) -> RobustnessFile:
    """Read a robustness.json. Raises UserError."""
    try:
        return RobustnessFile.model_validate(read_json(path, MAX_BYTES))
    except ValidationError as error:
        raise UserError(
            f"{shown(path)} is refused: {first_complaint(error)}; run 'starleth robustness' again."
        ) from None


if __name__ == "__main__":
    print(json.dumps(json_schema(RobustnessFile, SCHEMA_ID), indent=1, ensure_ascii=False))
