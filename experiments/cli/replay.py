"""`starleth replay`: run a tuned motion again and print its metrics as one JSON object."""

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import EffectsOption, ModelOption, start_jax

HELP = """Run a tuned motion again and print its metrics as one JSON object.

Takes a run's folder or a parameters.json, any drive (full, cheap, ideal) and any of three engines: moreau (the one
the search uses), mjx (mjx.step) and mujoco_c (MuJoCo C at small steps with its own contact).

    starleth replay runs/squat_jump
    starleth replay runs/squat_jump --drive ideal
    starleth replay runs/squat_jump/parameters.json --engine mujoco_c
    starleth replay runs/my_jump --task my_jump.json
    starleth replay squat_jump --initial-guess        the task before any search
"""


def register(app: typer.Typer) -> None:
    app.command("replay", help=HELP)(command)


def command(
    source: Annotated[str, typer.Argument(help="A run's folder, a parameters.json, or a task with --initial-guess.")],
    drive: Annotated[str | None, typer.Option(help="full, cheap or ideal. Default: the one it was tuned on.")] = None,
    engine: Annotated[str, typer.Option(help="moreau, mjx or mujoco_c.")] = "moreau",
    model: ModelOption = None,
    effects: EffectsOption = None,
    task: Annotated[str | None, typer.Option(help="Your own task file, if it was tuned with one.")] = None,
    initial_guess: Annotated[bool, typer.Option("--initial-guess", help="Replay a task's initial guess.")] = False,
) -> None:
    start_jax(1)
    from experiments import replay
    from experiments.effects.library import load_effects
    from experiments.errors import UserError
    from experiments.files import json_line
    from experiments.model import load_model
    from experiments.tasks.definition import load_task

    library = load_effects(effects or ())
    robot = load_model(model, library)
    if initial_guess:
        if task is not None:
            raise UserError("With --initial-guess give the task file as the first argument; leave --task away.")
        definition = load_task(source)
        values, tuned_on = replay.initial_guess(definition), "full"
    else:
        motion = replay.load_motion(Path(source), robot, task)
        definition, values, tuned_on = motion.definition, motion.values, motion.file.drive
    score, _ = replay.replay(values, definition, robot, drive or tuned_on, engine, library)
    print(json_line(replay.summary(score, definition, robot, drive or tuned_on, engine)))
