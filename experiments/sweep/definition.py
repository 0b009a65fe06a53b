"""What a sweep is: tasks x models x seeds, each member a `starleth tune` run in a folder of its own.

sweep.json file            {"tasks": ["squat_jump"], "seeds": "0-7", "models": ["nominal", "learned.json"]}
DIR/run.json               the sweep, held by one process at a time
DIR/members/NAME/          a run folder of tune; NAME is derived, never read from a file
DIR/outcomes/NAME.json     how the member's last attempt ended
DIR/logs/NAME.log          what it printed
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidationError, model_validator

from experiments.errors import UserError
from experiments.files import Strict, first_complaint, read_json, shown

MAX_BYTES: Final = 1_000_000
MAX_MEMBERS: Final = 10_000
LARGEST_SEED: Final = 2**31 - 1
NOMINAL: Final = "nominal"
MEMBERS, OUTCOMES, LOGS = "members", "outcomes", "logs"

_RANGE: Final = re.compile(r"^(\d{1,10})(?:-(\d{1,10}))?$")
# a word as `starleth tune` takes it: never an option, never something the shell or a terminal acts on
Source = Annotated[str, Field(min_length=1, max_length=1000, pattern=r"^[^\-\s\x00-\x1f\x7f][^\x00-\x1f\x7f]*$")]


class Sweep(Strict):
    """Schema of a sweep file. Paths in it are relative to the file's folder."""

    schema_version: Literal[1] = 1
    about: Annotated[str, Field(max_length=2000)] = ""
    tasks: Annotated[tuple[Source, ...], Field(min_length=1, max_length=1000)]
    models: Annotated[tuple[Source, ...], Field(min_length=1, max_length=1000)] = (NOMINAL,)
    seeds: Annotated[str, Field(max_length=2000, description="such as 0-7 or 1,4,9-12")] = "0"
    drive: Literal["full", "cheap", "ideal"] = "full"
    generations: Annotated[int, Field(ge=1, le=10_000_000)] | None = None
    population: Annotated[int, Field(ge=4, le=1_000_000)] | None = None
    perturbations: Source | None = None
    trials: Annotated[int, Field(ge=1, le=10_000)] | None = None
    risk: Literal["mean", "worst", "cvar"] | None = None
    alpha: Annotated[float, Field(ge=0, lt=1)] | None = None

    @model_validator(mode="after")
    def _each_once(self) -> "Sweep":
        parse_seeds(self.seeds)
        for kind in ("tasks", "models"):
            sources = getattr(self, kind)
            labels = [label(source) for source in sources]
            twice = next((one for one in labels if labels.count(one) > 1), None)
            if twice is not None:
                raise ValueError(f"two of the {kind} are called '{twice}'; rename one of the files")
        if self.count > MAX_MEMBERS:
            raise ValueError(f"{self.count} members are more than the {MAX_MEMBERS} of one sweep; make several sweeps")
        return self

    @property
    def count(self) -> int:
        return len(self.tasks) * len(self.models) * len(parse_seeds(self.seeds))

    def members(self) -> tuple["Member", ...]:
        """All searches, in a fixed order."""
        return tuple(
            Member(f"{label(task)}.{label(model)}.seed{seed}", task, model, seed)
            for task in self.tasks
            for model in self.models
            for seed in parse_seeds(self.seeds)
        )

    def tune_arguments(self, member: "Member") -> list[str]:
        """The words of the command line that decide the member's result."""
        named = {
            "seed": member.seed,
            "model": None if member.model == NOMINAL else member.model,
            "drive": self.drive,
            "generations": self.generations,
            "population": self.population,
            "perturbations": self.perturbations,
            "trials": self.trials,
            "risk": self.risk,
            "alpha": self.alpha,
        }
        return [member.task, *(f"--{name}={value}" for name, value in named.items() if value is not None)]

    def located(self, folder: Path) -> "Sweep":
        """The same sweep with the paths of files absolute, so that it may be gone on with from anywhere."""

        def absolute(source: str) -> str:
            return str((folder / source).absolute()) if source.endswith(".json") else source

        return self.model_copy(
            update={
                "tasks": tuple(map(absolute, self.tasks)),
                "models": tuple(map(absolute, self.models)),
                "perturbations": None if self.perturbations is None else absolute(self.perturbations),
            }
        )


@dataclass(frozen=True)
class Member:
    """One search of a sweep."""

    name: str  # also the name of its folder: made of letters, digits, '_', '-' and two dots
    task: str
    model: str
    seed: int


def label(source: str) -> str:
    """A task's or model's file or name as a part of a file name: no slashes, no dots."""
    return re.sub(r"[^A-Za-z0-9_\-]+", "_", Path(source).name.removesuffix(".json"))[:80] or "_"


def parse_seeds(text: str) -> tuple[int, ...]:
    """'0-2,7' is (0, 1, 2, 7). Raises ValueError in one sentence."""
    seeds: list[int] = []
    for part in text.split(","):
        match = _RANGE.match(part.strip())
        if match is None:
            raise ValueError(f"seeds '{shown(part)}' are no number or range; write them as 0-7 or 1,4,9-12")
        first, last = int(match[1]), int(match[2] or match[1])
        if last < first or last > LARGEST_SEED:
            raise ValueError(f"seeds '{shown(part)}' do not rise within 0 and {LARGEST_SEED}")
        if last - first >= MAX_MEMBERS:
            raise ValueError(f"seeds '{shown(part)}' are more than the {MAX_MEMBERS} members of one sweep")
        seeds += range(first, last + 1)
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"seeds '{shown(text)}' name a seed twice")
    return tuple(seeds)


def load_sweep(path: Path) -> Sweep:
    """The sweep of a file, its paths absolute. Raises UserError."""
    return parse_sweep(read_json(path, MAX_BYTES), shown(path)).located(path.absolute().parent)


def parse_sweep(content: Any, source: str) -> Sweep:
    """Check the content of a sweep file. Raises UserError naming the key."""
    try:
        return Sweep.model_validate(content)
    except ValidationError as error:
        raise UserError(f"{source}: {first_complaint(error)}.") from None
