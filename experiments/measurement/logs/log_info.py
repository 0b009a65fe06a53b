"""The small JSON beside a log: which robot, which experiment, how often sampled, how noisy."""

from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from experiments.errors import UserError
from experiments.files import first_complaint, read_json, shown
from experiments.measurement.logs.log import SIGNALS, BenchJoint

MAX_BYTES: Final = 1_000_000  # a thousand times what the format needs

Text = Annotated[str, Field(max_length=2000)]


class LogInfo(BaseModel):
    """Schema of the JSON beside the table. Keys that it does not know are kept aside, not refused."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    robot: Literal["starleth", "joint"]
    experiment: Literal["fixed_base", "ground", "bench"]
    sample_period: float = Field(gt=0, le=10)  # s
    noise_std: dict[str, Annotated[float, Field(ge=0)]] = {}
    joint: BenchJoint | None = None
    drive: Literal["rigid", "HAA", "HFE", "KFE"] | None = None  # of the joint on the bench, unless it says so itself
    units: dict[str, Text] = {}
    source: Text = ""

    @model_validator(mode="after")
    def _belongs_together(self) -> Self:
        if (self.robot == "joint") != (self.joint is not None):
            raise ValueError("robot 'joint' needs its numbers under the key 'joint', and no other robot has them")
        if (self.robot == "joint") != (self.experiment == "bench"):
            raise ValueError("experiment 'bench' goes with robot 'joint', the other experiments with 'starleth'")
        for key, table in (("noise_std", self.noise_std), ("units", self.units)):
            for signal in table:
                if signal not in SIGNALS and signal != "time":
                    raise ValueError(f"'{key}' names a signal '{signal[:80]}' that the format does not have")
        return self

    @property
    def unknown_keys(self) -> tuple[str, ...]:
        """Keys of the file that the schema does not know."""
        return tuple(self.model_extra or ())


def read_info(path: Path) -> LogInfo:
    """The JSON of a log. Raises UserError in one sentence if it is missing, damaged or of another kind."""
    return parse_info(read_json(path, MAX_BYTES), shown(path))


def parse_info(data: Any, what: str) -> LogInfo:
    """Checked content of a log's JSON; `what` names it in the UserError."""
    try:
        return LogInfo.model_validate(data)
    except ValidationError as error:
        raise UserError(f"{what}: {first_complaint(error)}.") from None
