"""Which module brings which task."""

from collections.abc import Mapping
from types import ModuleType

from experiments.errors import UserError
from experiments.files import shown
from experiments.model import Model
from experiments.rollout import Task
from experiments.tasks import gait, squat_jump
from experiments.tasks.definition import TaskDefinition

GAITS = ("running_trot", "walking_trot", "lateral_walk", "bound", "pronk")
MODULES: Mapping[str, ModuleType] = {"squat_jump": squat_jump} | dict.fromkeys(GAITS, gait)


def make_task(definition: TaskDefinition, model: Model) -> Task:
    """The task of a definition on a robot. Raises UserError."""
    if model.numbers is None:
        raise UserError("This model is a single joint on a bench: it has no legs to move; give a model of the robot.")
    try:
        return module_of(definition.task).make_task(definition, model)
    except (TypeError, ValueError, AttributeError, OverflowError) as error:  # its settings are free in the schema
        raise UserError(f"Task {definition.task}: a setting is of the wrong kind ({shown(str(error))}).") from None


def metric_units(task: str) -> Mapping[str, str]:
    """Units of the task's metrics."""
    return module_of(task).METRIC_UNITS


def module_of(task: str) -> ModuleType:
    """The module that brings a task. Raises UserError."""
    if task not in MODULES:
        raise UserError(f"No task '{task}'; the tasks are {', '.join(MODULES)}.")
    return MODULES[task]
