"""What the gaits meet in the benchmark: the task's own perturbations, and one disturbance after the other (VI.A)."""

from collections.abc import Callable
from typing import Final, NamedTuple

import jax
import numpy as np

from experiments.gait_benchmark.trials import Cases, cases
from experiments.model import Model
from experiments.perturbations import nominal_columns, parse_perturbations
from experiments.tasks.definition import TaskDefinition
from experiments.tasks.gait_parameters import GaitSettings
from experiments.trial import DISTURBANCES

MEETING: Final = 3.0  # s, when a push sets in: the gait goes on for one second then
AFTER: Final = 5.0  # s in which a gait may still fall over what it met
BOARD_START, BOARD_SPREAD, BOARD_LENGTH, BOARD_WIDTH = 0.5, 0.3, 0.3, 0.3  # m
BOARD_SIDE: Final = 0.2  # m from the middle: under the feet of one side
TURNING: Final = 0.5  # rad/s, a full turn on the slope
TURN_START: Final = 2.2  # s
SLOWEST: Final = 0.1  # m/s, below which no gait is waited for


class Sweep(NamedTuple):
    """One disturbance in growing steps."""

    name: str
    title: str
    unit: str
    levels: tuple[float, ...]
    asked: float  # the paper's robot bears it (VI.A)


SWEEPS: Final = (
    Sweep("push", "Sideways push for 0.5 s", "N", (0.0, 20.0, 40.0, 60.0, 80.0, 100.0), 100.0),
    Sweep("obstacle", "Unperceived board under the feet of one side", "m", (0.0, 0.01, 0.02, 0.03, 0.04, 0.05), 0.05),
    Sweep("slope", "Slope, with a full turn on it", "°", (0.0, 5.0, 10.0, 15.0, 18.0, 21.0), 21.0),
    Sweep("friction", "Friction of the ground", "1", (0.3, 0.4, 0.5, 0.6, 0.7, 0.8), 0.4),
)
EXTRA: Final = ("obstacle_length", "obstacle_width")
CALM: Final = ("push_x", "push_y", "slope_x", "slope_y", "obstacle_height", "ground_friction")


def drawn(definition: TaskDefinition, model: Model, trials: int, seed: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The task's own perturbations: numbers by name and the starts of their noise, (trials,) each."""
    law = parse_perturbations(definition.perturbations, definition.task, model)
    numbers, noise = law.columns(jax.random.key(seed), trials)
    return numbers | {name: np.full(trials, DISTURBANCES[name].nominal, np.float32) for name in EXTRA}, noise


def nominal(definition: TaskDefinition, model: Model) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """One trial with nothing off, in the same form."""
    names = (*parse_perturbations(definition.perturbations, definition.task, model).names, *EXTRA)
    values = nominal_columns(names, model)
    return {name: np.full(1, value, np.float32) for name, value in values.items()}, np.zeros(1, np.int32)


def swept(
    sweep: Sweep,
    definition: TaskDefinition,
    model: Model,
    settings: GaitSettings,
    stride: float,
    trials: int,
    seed: int,
) -> Cases:
    """All levels of one disturbance (levels * trials,), the trials running fastest.

    Masses, springs, friction of the gears and sensor noise are the task's own draws; the trials spread over the
    stride, both sides, and all directions of the slope.
    """
    numbers, noise = drawn(definition, model, trials, seed)
    calm = nominal_columns(CALM, model)
    numbers |= {name: np.full(trials, value, np.float32) for name, value in calm.items()}
    levels = np.repeat(np.float32(sweep.levels), trials)
    numbers = {name: np.tile(values, len(sweep.levels)) for name, values in numbers.items()}
    share = np.tile(np.arange(trials) / trials, len(sweep.levels)).astype(np.float32)
    side = np.where(np.arange(len(levels)) % 2, -1.0, 1.0).astype(np.float32)
    change, duration, settings = KINDS[sweep.name](model, settings, levels, share, side, np.float32(stride))
    return cases(settings, numbers | change, np.tile(noise, len(sweep.levels)), duration)


def _push(model, settings, level, share, side, stride):
    change = {"push_y": side * level, "push_start": MEETING + share * stride, "push_duration": np.full_like(level, 0.5)}
    return change, MEETING + float(stride) + AFTER, settings


def _obstacle(model, settings, level, share, side, stride):
    size = {"obstacle_length": np.full_like(level, BOARD_LENGTH), "obstacle_width": np.full_like(level, BOARD_WIDTH)}
    place = {"obstacle_x": BOARD_START + share * BOARD_SPREAD, "obstacle_y": BOARD_SIDE * side}
    way = BOARD_START + BOARD_SPREAD + BOARD_LENGTH + 0.25  # until the hind feet have passed it
    speed = max(float(settings.command.heading), SLOWEST)
    return {"obstacle_height": level} | size | place, MEETING + way / speed, settings


def _slope(model, settings, level, share, side, stride):
    rise = np.tan(np.radians(level))
    change = {"slope_x": rise * np.cos(2 * np.pi * share), "slope_y": rise * np.sin(2 * np.pi * share)}
    turning = settings.command._replace(turning=np.float32(TURNING))
    settings = settings._replace(command=turning, turn_start=np.float32(TURN_START))
    return change, TURN_START + 2 * np.pi / TURNING + 1.0, settings


def _friction(model, settings, level, share, side, stride):
    return {"ground_friction": level / np.float32(model.numbers.contact.friction)}, MEETING + AFTER, settings


KINDS: Final[dict[str, Callable]] = {"push": _push, "obstacle": _obstacle, "slope": _slope, "friction": _friction}
