"""Every reader of a file from outside, with the hostile files that it is tried on."""

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from experiments.errors import UserError
from experiments.fuzz import mutations as hostile
from experiments.fuzz.good_files import (
    GOOD_TOML,
    good_csv,
    good_gzip,
    good_info,
    good_map,
    good_model,
    good_npz,
    good_parameters,
    good_parquet,
    good_robustness,
    good_sweep,
    shipped,
)
from experiments.fuzz.hostile_files import (
    one_file,
    parquet_file,
    prepare_checkpoints,
    prepare_run_folder,
    prepare_sweep_folder,
    signed_parameters,
    torn,
    with_info,
    with_log,
)

if TYPE_CHECKING:
    from experiments.model import Model


@dataclass(frozen=True)
class Reader:
    """`prepare(folder, chance)` leaves a hostile input; `read(folder)` reads it, and uses what it read a little.

    `read` must return or raise UserError with one sentence. `heavy`: an input costs so much more than others that
    only every heavy-th is taken.
    """

    name: str
    prepare: Callable[[Path, random.Random], None]
    read: Callable[[Path], Any]
    heavy: int = 1


def _read_parameters(folder: Path) -> None:
    from experiments import parameter_file

    parameter_file.read_parameters(folder / "parameters.json", robot="starleth", allow_ungated=True).values()


def _read_robustness(folder: Path) -> None:
    from experiments.robustness.file import read_robustness

    read_robustness(folder / "robustness.json")


def _read_model(folder: Path) -> None:
    from experiments.model import load_model

    model = load_model(folder / "model.json")
    model.hash()


def _read_task(folder: Path) -> None:
    from experiments.tasks.definition import load_task
    from experiments.tasks.registry import make_task

    definition = load_task(str(folder / "task.json"))
    definition.with_generations(500_000)
    make_task(definition, _nominal())


def _read_perturbations(folder: Path) -> None:
    from experiments.perturbations import load_perturbations

    found = load_perturbations(folder / "perturbations.json", _nominal())
    draws = np.linspace(0, 1, 3)
    for law in found.draw.values():
        law.draw(draws).astype(np.float32)


@cache
def _nominal() -> "Model":
    from experiments.model import nominal_model

    return nominal_model()


def _read_sweep(folder: Path) -> None:
    from experiments.sweep.definition import load_sweep

    sweep = load_sweep(folder / "sweep.json")
    for member in sweep.members():
        if "/" in member.name or member.name.startswith(".") or len(member.name) > 200:
            raise AssertionError(f"the name {member.name!r} leaves the sweep's folder")
        if any(word.startswith("--effects") for word in sweep.tune_arguments(member)):
            raise AssertionError("a data file brought code")


def _read_log(folder: Path) -> None:
    from experiments.measurement.logs.log_reader import read_log

    log = next(path for path in folder.iterdir() if path.name.startswith("log") and path.suffix != ".json")
    maps = [path for path in folder.iterdir() if path.name.startswith("map")]
    found = read_log(log, column_map=maps[0] if maps else None)
    found.joints("joint_torque")


def _read_sweep_folder(folder: Path) -> None:
    """run.json, outcome and results of a member as `collect` reads them."""
    from experiments.sweep.collect import collect, summary
    from experiments.sweep.definition import Sweep

    summary(collect(folder, Sweep(tasks=("a",))))


def _read_run_folder(folder: Path) -> None:
    from experiments.run_folder import open_run

    with open_run(folder / "run", "tune", {"seed": 1}):
        pass


def _read_checkpoints(folder: Path) -> None:
    import es

    checkpointer = es.Checkpointer(folder / "checkpoints", {"task": "x"}, notify=lambda sentence: None)
    checkpointer.open({"settings": 1})
    try:
        arrays = checkpointer.load()
    except es.CheckpointError as error:
        raise UserError(f"{error}.") from None
    if arrays is None or not all(isinstance(value, np.ndarray) for value in arrays.values()):
        raise AssertionError("the older, whole checkpoint was not found")


def _read_effect(folder: Path) -> None:
    from experiments.effects.library import load_effects

    load_effects([folder / "effect.py"])


TASKS: Final = "experiments.tasks"

READERS: Final[tuple[Reader, ...]] = (
    Reader("parameters", one_file("parameters.json", good_parameters, signed_parameters), _read_parameters),
    Reader("robustness", one_file("robustness.json", good_robustness, hostile.json_file), _read_robustness),
    Reader("model", one_file("model.json", good_model, hostile.json_file), _read_model),
    Reader("numbers", one_file("model.json", shipped("mjx_starleth", "starleth.json"), hostile.json_file), _read_model),
    Reader("task", one_file("task.json", shipped(TASKS, "squat_jump.json"), hostile.json_file), _read_task),
    Reader("gait task", one_file("task.json", shipped(TASKS, "running_trot.json"), hostile.json_file), _read_task),
    Reader(
        "perturbations",
        one_file("perturbations.json", shipped("experiments", "perturbations.json"), hostile.json_file),
        _read_perturbations,
    ),
    Reader("sweep", one_file("sweep.json", good_sweep, hostile.json_file), _read_sweep),
    Reader("sweep folder", prepare_sweep_folder, _read_sweep_folder),
    Reader("run folder", prepare_run_folder, _read_run_folder, heavy=4),
    Reader("log csv", with_info(one_file("log.csv", good_csv, hostile.csv_file)), _read_log),
    Reader("log csv.gz", with_info(one_file("log.csv.gz", good_gzip, hostile.gzip_file)), _read_log, heavy=4),
    Reader("log parquet", with_info(one_file("log.parquet", good_parquet, parquet_file)), _read_log),
    Reader("log npz", with_info(one_file("log.npz", good_npz, hostile.npz_file)), _read_log),
    Reader("log json", with_log(one_file("log.json", good_info, hostile.json_file)), _read_log),
    Reader("column map json", with_log(one_file("map.json", good_map, hostile.json_file)), _read_log),
    Reader("column map toml", with_log(one_file("map.toml", lambda: GOOD_TOML, hostile.damaged)), _read_log),
    Reader("checkpoints", prepare_checkpoints, _read_checkpoints, heavy=10),
    Reader("effect", one_file("effect.py", shipped("experiments.examples", "cogging.py"), torn), _read_effect),
)
