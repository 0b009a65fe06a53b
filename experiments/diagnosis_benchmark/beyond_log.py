"""Beyond the log: does a jump that is tuned on the learned model do better on the robot than one on the nominal model?

The robot is the independent plant with a hidden effect. It moves its legs in the air, the log is diagnosed, what was
found goes into the model; then both jumps are replayed on it.
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from controller_jax.types import RobotState
from experiments.effects.library import LIBRARY
from experiments.files import read_json, write_json
from experiments.independent_plant.generate import write_batch
from experiments.independent_plant.library import Effect
from experiments.independent_plant.play import Jump, State, Targets, replay_jump
from experiments.independent_plant.runner import Case
from experiments.measurement.diagnose import diagnose
from experiments.measurement.intake import read_checked
from experiments.measurement.learn import learn
from experiments.model import Model, load_model, nominal_model, save_model
from experiments.perturbations import perturbations_of_task
from experiments.plant import make_plant
from experiments.run_folder import open_run
from experiments.tasks.definition import TaskDefinition, load_task
from experiments.tasks.registry import make_task
from experiments.trial import nominal_trial
from experiments.tune import TuneOptions, tune

TASK = "squat_jump"
LOG_DURATION = 8.0  # s
MAX_BYTES = 50_000_000


def beyond_log(
    folder: Path, hidden: Effect, generations: int, seed: int, devices: int, say: Callable[[str], None]
) -> dict[str, Any]:
    """Apexes [m] of both jumps, each as its model promised and as the robot reached. Raises UserError."""
    log = _log(folder, hidden, seed)
    answer, learned = _learned(folder, log, say)
    definition = load_task(TASK).with_generations(generations)
    found: dict[str, Any] = {"hidden": f"{hidden.effect}@{hidden.where}", "parameters": hidden.parameters}
    found |= {"verdict": answer["verdict"], "learned": [f"{e.effect}@{e.where}" for e in learned.effects]}
    for name, model in (("nominal", nominal_model()), ("learned", learned)):
        say(f"tuning a jump on the {name} model")
        values, promised = _tuned(folder / name, definition, model, seed, devices)
        jumps = {
            robot: jump(values, definition, model, effects) for robot, effects in (("robot", (hidden,)), ("sound", ()))
        }
        found[name] = {
            "promised": round(promised, 4),
            "on_robot": round(jumps["robot"].apex_height, 4),
            "on_robot_without_effect": round(jumps["sound"].apex_height, 4),
            "fallen": jumps["robot"].fallen,
        }
    lost = found["nominal"]["promised"] - found["nominal"]["on_robot"]
    return found | {
        "lost": round(lost, 4),
        "won_back": round(found["learned"]["on_robot"] - found["nominal"]["on_robot"], 4),
    }


def _log(folder: Path, hidden: Effect, seed: int) -> Path:
    """A log of the legs in the air, on the robot with the effect."""
    if not (folder / "log" / "case_0001.csv.gz").exists():
        write_batch([Case("air", effects=(hidden,), seed=seed, duration=LOG_DURATION)], [1], folder / "log")
    return folder / "log" / "case_0001.csv.gz"


def _learned(folder: Path, path: Path, say: Callable[[str], None]) -> tuple[Mapping[str, Any], Model]:
    """The diagnosis of the log, and the model with what it names; both are kept in the folder."""
    told, learned = folder / "diagnosis.json", folder / "model.json"
    if told.exists() and learned.exists():
        return read_json(told, MAX_BYTES), load_model(learned)
    log, nominal = read_checked(path, None, nominal_model()), nominal_model()
    answer = diagnose([log], nominal, LIBRARY, say).answer
    wanted = [(entry["effect"], entry["where"]) for entry in answer["effects"]]
    model = learn([log], nominal, LIBRARY, wanted)[0] if wanted else nominal
    write_json(told, answer)
    save_model(learned, model)
    return answer, model


def _tuned(folder: Path, definition: TaskDefinition, model: Model, seed: int, devices: int) -> tuple[np.ndarray, float]:
    """Parameters of the best jump on a model, and the apex that it reaches there."""
    perturbations = perturbations_of_task(definition, None, model, LIBRARY)
    options = TuneOptions(definition, model, seed, perturbations, devices=devices)
    with open_run(folder, "tune", options.settings()) as run:
        judged = tune(options, run, lambda progress, extra: None, lambda text: None)
    return judged.values, float(judged.nominal.metrics["apex_height"])


def jump(values: np.ndarray, definition: TaskDefinition, model: Model, effects: tuple[Effect, ...]) -> Jump:
    """The jump of these parameters on the independent plant with effects; `model` is what the controller knows."""
    task, plant = make_task(definition, model), make_plant(model)
    values = jnp.asarray(values, jnp.float32)
    start, state = task.start(plant, plant.prepare(plant.params), task.settings, values, nominal_trial())
    control = jax.jit(partial(task.control, task.settings, values))

    def controller(seen: State, tick: int) -> Targets:
        nonlocal state
        robot = RobotState(*(jnp.asarray(x, jnp.float32) for x in seen))
        state, targets, _ = control(state, robot, jnp.float32(tick * task.period))
        return Targets(*(np.asarray(x, float) for x in (targets.torque, targets.position, targets.position_mode)))

    return replay_jump(controller, task.ticks * task.period, effects, float(start.bodies.q[2]))
