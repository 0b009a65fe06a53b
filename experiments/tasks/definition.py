"""A task's definition as a file: parameters with unit and bounds, cost weights, stages of the search."""

import hashlib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import rfc8785
from pydantic import Field, FiniteFloat, ValidationError, model_validator

from es import Parameter, ParameterSpace
from experiments.errors import UserError
from experiments.files import Strict, first_complaint, read_json, shown
from experiments.parameter_schema import ParameterFile

MAX_BYTES = 1_000_000
MOST_ROLLOUTS = 10_000_000  # of one generation: their scores are held at once


class ParameterDefinition(Strict):
    """One searched number."""

    name: Annotated[str, Field(max_length=80)]
    unit: str
    low: FiniteFloat
    high: FiniteFloat
    initial: FiniteFloat


class StageDefinition(Strict):
    """One stage of the search: how faithful the plant is, and for how long."""

    name: Annotated[str, Field(max_length=80)]
    drive: Literal["ideal", "cheap", "full"]
    sensing: Literal["direct", "estimated"] = "direct"  # perfect state, or what the robot's own senses tell
    generations: Annotated[int, Field(ge=1, le=100_000)]
    torque_limit: Annotated[float, Field(gt=0, le=100)] = 1.0  # factor on the joint torque limits of the ideal drive
    sigma_floor: Annotated[float, Field(ge=0, le=1)] = 0.0
    perturbed: bool = False  # candidates meet the task's perturbations, the same ones in one generation
    trials: Annotated[int, Field(ge=1, le=10_000)] = 1  # per candidate


class TaskDefinition(Strict):
    """The contents of a task file. `settings` are the task's own fixed numbers."""

    task: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_\-]*$", max_length=100)]  # names the run's folder
    about: str = ""
    duration: Annotated[float, Field(gt=0, le=120)]
    parameters: tuple[ParameterDefinition, ...]
    weights: dict[str, Annotated[float, Field(ge=-1e9, le=1e9)]]
    settings: dict[str, Any] = Field(default_factory=dict)
    population: Annotated[int, Field(ge=4, le=1_000_000)] = 15
    sigma: Annotated[float, Field(gt=0, lt=1)] = 0.2
    stages: Annotated[tuple[StageDefinition, ...], Field(min_length=1, max_length=100)]
    perturbations: dict[str, Any] = Field(default_factory=dict)
    # laws that are harder while searching than those that judge the result
    search_perturbations: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _stages_apart(self) -> Self:
        names = [stage.name for stage in self.stages]
        if len(set(names)) < len(names):
            raise ValueError("two of the stages have the same name")
        return self

    def space(self) -> ParameterSpace:
        """The parameters as a search space."""
        return ParameterSpace(tuple(Parameter(p.name, p.unit, p.low, p.high, p.initial) for p in self.parameters))

    def hash(self) -> str:
        """What a replay of the task depends on, in 16 hexadecimal digits; not how it was searched.

        Raises ValueError for a setting that is no JSON number (RFC 8785).
        """
        identity = {
            "task": self.task,
            "duration": self.duration,
            "parameters": [[p.name, p.unit] for p in self.parameters],
            "weights": self.weights,
            "settings": self.settings,
            "sensing": self.stages[-1].sensing,
        }
        return hashlib.sha256(rfc8785.dumps(identity)).hexdigest()[:16]

    def with_generations(self, total: int) -> "TaskDefinition":
        """The stages shortened or stretched to `total` generations, in proportion, one at least."""
        if total < len(self.stages):
            least = len(self.stages)
            raise UserError(
                f"{total} generations are too few for the {least} stages of this task; give {least} or more."
            )
        now = sum(stage.generations for stage in self.stages)
        counts = [max(1, total * stage.generations // now) for stage in self.stages]
        counts[-1] += total - sum(counts)
        while counts[-1] < 1:
            counts[counts.index(max(counts))] -= 1
            counts[-1] += 1
        stages = [s.model_copy(update={"generations": n}) for s, n in zip(self.stages, counts, strict=True)]
        return self.model_copy(update={"stages": tuple(stages)})

    def going_on_from(self, values: Mapping[str, float]) -> "TaskDefinition":
        """The search around a motion that was found before: its last stage alone, in steps half as wide.

        Raises UserError for values of other parameters or outside of their bounds.
        """
        try:
            self.space().vector(values)
        except ValueError as error:
            raise UserError(f"The search cannot start there: {error}; start from a motion of this task.") from None
        begun = tuple(p.model_copy(update={"initial": values[p.name]}) for p in self.parameters)
        return self.model_copy(update={"parameters": begun, "stages": self.stages[-1:], "sigma": 0.5 * self.sigma})

    def with_trials(self, count: int) -> "TaskDefinition":
        """The last stage with so many perturbed trials for each candidate."""
        last = self.stages[-1].model_copy(update={"perturbed": True, "trials": count})
        return self.model_copy(update={"stages": (*self.stages[:-1], last)}).bounded()

    def with_population(self, count: int) -> "TaskDefinition":
        """The same search with so many candidates in a generation."""
        return self.model_copy(update={"population": count}).bounded()

    def with_options(self, generations: int | None, population: int | None, trials: int | None) -> "TaskDefinition":
        """The same search with what is given of its size; 0 generations leave its stages. Raises UserError."""
        asked = self.with_generations(generations) if generations else self
        if population is not None:
            asked = asked.with_population(population)
        return asked if trials is None else asked.with_trials(trials)

    def bounded(self) -> "TaskDefinition":
        """Itself, unless a generation would not fit into any memory. Raises UserError."""
        trials = max(stage.trials for stage in self.stages)
        if self.population * trials > MOST_ROLLOUTS:
            raise UserError(
                f"Task {self.task}: {self.population} candidates in {trials} trials each are more than the "
                f"{MOST_ROLLOUTS} rollouts of one generation; take fewer."
            )
        return self


def task_names() -> tuple[str, ...]:
    """The tasks that come with the program."""
    folder = resources.files("experiments.tasks")
    return tuple(sorted(item.name.removesuffix(".json") for item in folder.iterdir() if item.name.endswith(".json")))


def load_task(name_or_file: str) -> TaskDefinition:
    """A task by name, or from the user's own file ending in .json. Raises UserError."""
    if name_or_file.endswith(".json"):
        return parse_task(read_json(Path(name_or_file), MAX_BYTES), name_or_file)
    if name_or_file not in task_names():
        raise UserError(
            f"No task '{shown(name_or_file)}'; the tasks are {', '.join(task_names())}, or give a .json file."
        )
    with resources.as_file(resources.files("experiments.tasks") / f"{name_or_file}.json") as path:
        return parse_task(read_json(path, MAX_BYTES), path.name)


def task_of(file: ParameterFile, path: Path, own: str | None = None) -> TaskDefinition:
    """The task that a parameter file was tuned for: the shipped one, or the user's own file. Raises UserError."""
    definition = load_task(own or file.task)
    name = shown(path)
    if definition.task != file.task or set(definition.space().names) != set(file.values()):
        raise UserError(
            f"{name} holds parameters of another task than '{definition.task}'; give the task file it was tuned with "
            "by --task FILE."
        )
    if file.task_hash not in (None, definition.hash()):
        raise UserError(
            f"{name} was tuned for a task '{file.task}' of another duration, weights or settings; give the task file "
            "it was tuned with by --task FILE."
        )
    return definition


def parse_task(content: Any, source: str) -> TaskDefinition:
    """Check a task file's content; raises UserError naming the key."""
    try:
        definition = TaskDefinition.model_validate(content)
        definition.space()
        definition.hash()
    except ValidationError as error:
        raise UserError(f"{shown(source)}: {first_complaint(error)}.") from None
    except ValueError as error:
        raise UserError(f"{shown(source)}: {shown(str(error))}.") from None
    return definition.bounded()


def check_weights(weights: Mapping[str, float], known: tuple[str, ...], task: str) -> None:
    """Every cost term has a weight, and no other does. Raises UserError."""
    unknown, missing = set(weights) - set(known), set(known) - set(weights)
    if unknown or missing:
        raise UserError(
            f"Task {task}: its cost terms are {', '.join(known)}; correct the key '{shown(min(unknown | missing))}'."
        )
