"""Beyond the log: does a jump that is tuned on the learned model do better on the robot than one on the nominal model?

The robot is the independent plant with a hidden effect. Its log is diagnosed, what was found goes into the model. From
a jump of the nominal model, as a user has one, the same search goes on once on the nominal model and once on the
learned one; both results are replayed on the robot.
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
from experiments.errors import UserError
from experiments.files import read_json, write_json
from experiments.independent_plant.generate import write_batch
from experiments.independent_plant.library import Effect
from experiments.independent_plant.play import Jump, State, Targets, replay_jump
from experiments.independent_plant.runner import Case
from experiments.independent_plant.strength import reachable
from experiments.measurement.diagnose import diagnose
from experiments.measurement.intake import read_checked
from experiments.measurement.learn import learn
from experiments.model import Model, load_model, nominal_model, save_model
from experiments.perturbations import perturbations_of_task
from experiments.plant import make_plant
from experiments.run_folder import make_answer_folder, open_run
from experiments.tasks.definition import TaskDefinition, load_task
from experiments.tasks.registry import make_task
from experiments.trial import nominal_trial
from experiments.tune import TuneOptions, tune

TASK = "squat_jump"
LOG_DURATION = 8.0  # s
LEAST_LOSS = 0.01  # m; two programs of one jump differ by as much through rounding alone
MAX_BYTES = 50_000_000


# What is hidden unless the user says otherwise: loads that the nominal jump falls over with, a sensor that makes it
# fall, and then what takes 0.07 m or more from it though it lands: a load above the torso, misleading torque sensors,
# soft springs, weak motors. Friction of a plausible size would not do: it takes less than a centimetre, so that there
# is nothing to win back.
HIDDEN = (
    Effect("payload", "torso", {"mass": 3.0, "x": 0.15, "z": 0.05}),
    Effect("payload", "torso", {"mass": 2.0, "x": -0.2, "z": 0.05}),
    Effect("torque_sensor_offset", "KFE", {"offset": 2.0}),
    Effect("payload", "torso", {"mass": 3.0, "z": 0.1}),
    Effect("torque_sensor_gain", "all", {"change": 0.15}),
    Effect("spring_stiffness", "all", {"change": -0.3}),
    Effect("torque_constant", "all", {"change": -0.15}),
)


def beyond_log(
    folder: Path, hidden: Effect, generations: int, seed: int, devices: int, say: Callable[[str], None]
) -> dict[str, Any]:
    """Both jumps, each as its model promised and as the robot reached it; what was lost and won back.

    `folder` holds the nominal jumps, which serve every effect, and a folder of its own for each. A jump is worth its
    height [m], by which the torso rises over the height that it stands at; one that ends in a fall is worth nothing.
    `lost` is what the effect takes from the nominal jump on the robot, `won_back` what the learned one has over it
    there, `ends_at` the torso's height in the end. Raises UserError.
    """
    name = f"{hidden.effect}@{hidden.where}"
    values_of = "".join(f",{key}={value:g}" for key, value in hidden.parameters.items())
    mine = folder / f"{name}{values_of}"
    _claim(mine, {"effect": name, "parameters": hidden.parameters, "seed": seed})
    answer, learned = _learned(mine, _log(mine, hidden, seed), say)
    begun = load_task(TASK).with_generations(generations)
    say("tuning a jump on the nominal model")
    first, _ = _tuned(folder / "first", begun, nominal_model(), seed, devices)
    definition = begun.going_on_from(begun.space().named(first)).with_generations(max(generations // 2, 1))
    standing = float(make_task(definition, nominal_model()).settings.landing_height)
    found: dict[str, Any] = {"hidden": name, "parameters": hidden.parameters, "verdict": answer["verdict"]}
    found["learned_effects"] = [f"{e.effect}@{e.where}" for e in learned.effects]
    both = (("nominal", folder, nominal_model(), None), ("learned", mine, learned, mine / "model.json"))
    for which, where, model, file in both:
        say(f"searching on from it on the {which} model")
        values, promised = _tuned(where / which, definition, model, seed, devices, file)
        reached = jump(values, definition, model, (hidden,))
        found[which] = {"promised_apex": round(promised, 4)} | _told(reached, standing)
        if which == "nominal":
            found["nominal_without_effect"] = _told(jump(values, definition, model, ()), standing)
    lost = found["nominal_without_effect"]["height"] - found["nominal"]["height"]
    won_back = found["learned"]["height"] - found["nominal"]["height"]
    share = round(won_back / lost, 3) if lost >= LEAST_LOSS else None
    return found | {"lost": round(lost, 4), "won_back": round(won_back, 4), "won_back_share": share}


def _told(jump: Jump, standing: float) -> dict[str, Any]:
    """A jump on the robot: what it is worth over the standing torso's height [m], and how it went."""
    apex, ends_at = jump.apex_height, float(jump.true["base_position"][-1, 2])
    return {
        "height": 0.0 if jump.fallen else round(apex - standing, 4),
        "apex": round(apex, 4),
        "fallen": jump.fallen,
        "ends_at": round(ends_at, 4),
    }


def _claim(folder: Path, settings: dict[str, Any]) -> None:
    """What lies in the folder is of the same robot and log, or it is refused."""
    make_answer_folder(folder)
    note = folder / "hidden.json"
    if note.exists() and read_json(note, MAX_BYTES) != settings:
        raise UserError(f"{folder} is of another robot or seed; choose a new folder.")
    write_json(note, settings)


def _log(folder: Path, hidden: Effect, seed: int) -> Path:
    """A log of the robot with the effect: legs in the air or, where these do not show it, hops."""
    log = folder / "log" / "case_0001.csv.gz"
    if not log.exists():
        motion = "air" if reachable("air", hidden.effect) else "hops"
        write_batch([Case(motion, effects=(hidden,), seed=seed, duration=LOG_DURATION)], [1], folder / "log")
    return log


def _learned(folder: Path, path: Path, say: Callable[[str], None]) -> tuple[Mapping[str, Any], Model]:
    """The diagnosis of the log, and the model with what it names; both are kept in the folder."""
    told, learned = folder / "diagnosis.json", folder / "model.json"
    if told.exists() and learned.exists():
        return read_json(told, MAX_BYTES), load_model(learned)
    log, nominal = read_checked(path, None, nominal_model()), nominal_model()
    answer = diagnose([log], nominal, LIBRARY, say).answer
    wanted = [(entry["effect"], entry["where"]) for entry in answer["effects"]]
    model = learn([log], nominal, LIBRARY, wanted) if wanted else nominal
    write_json(told, answer)
    save_model(learned, model)
    return answer, model


def _tuned(
    folder: Path, definition: TaskDefinition, model: Model, seed: int, devices: int, file: Path | None = None
) -> tuple[np.ndarray, float]:
    """Parameters of the best jump on a model (kept in `file` unless it is the nominal one), and its apex there [m]."""
    perturbations = perturbations_of_task(definition, None, model, LIBRARY)
    options = TuneOptions(definition, model, seed, perturbations, devices=devices, files={"--model": file})
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
