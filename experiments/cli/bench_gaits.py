"""`starleth bench gaits`: how long the gaits keep going, and what throws them over."""

import json
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import DevicesOption, ModelOption, SeedOption, available_cores, start_jax, whole_loops

HELP = """How long do the gaits keep going, and what throws them over?

For each gait that comes with the program, or each run or parameters.json given: unseen perturbed trials in the full
model with estimated state, beside the gait's initial guess; survival over sideways pushes, unperceived obstacles,
slopes with a full turn, and friction; and the same gait in MuJoCo C with its own contact. One JSON line per gait;
gaits.json and report.html in the output folder.

    starleth bench gaits                                   all
    starleth bench gaits --sweep-trials 8                  all, with fewer trials (8 minutes on one core)
    starleth bench gaits walking_trot runs/my_trot         these
    starleth bench gaits runs/my_trot --task my_trot.json  tuned with your own task file
    starleth bench gaits --sweep-trials 0 --no-mujoco-c    only the unseen trials
"""
UNSEEN = 20_000  # no search has seen this seed: searches use the task's own and the stream of its judge


def gaits(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[GAIT]...", help="Gaits, runs or parameter files.")
    ] = None,
    trials: Annotated[int, typer.Option(min=1, max=100_000, help="Unseen trials of each gait.")] = 100,
    cycles: Annotated[int, typer.Option(min=1, max=1000, help="Strides of an unseen trial.")] = 20,
    sweep_trials: Annotated[
        int, typer.Option(min=0, max=10_000, help="Trials at each size of each disturbance; 0: none.")
    ] = 16,
    seed: SeedOption = UNSEEN,
    mujoco_c: Annotated[bool, typer.Option(help="Replay each gait in MuJoCo C.")] = True,
    model: ModelOption = None,
    task: Annotated[str | None, typer.Option(help="Your own task file, if they were tuned with one.")] = None,
    devices: DevicesOption = available_cores(),  # noqa: B008
    folder: Annotated[Path, typer.Option("--output", "-o", help="Folder for gaits.json and report.html.")] = Path(
        "runs/bench_gaits"
    ),
) -> None:
    whole_loops()
    start_jax(devices)
    from experiments.command_line import command_line
    from experiments.files import refuse_unwritable, write_json
    from experiments.gait_benchmark.run import Plan, find_motions, measure
    from experiments.model import load_model
    from experiments.reports.gait_benchmark import write_gait_benchmark_report
    from experiments.run_folder import make_answer_folder

    robot = load_model(model)
    plan = Plan(find_motions(names or (), robot, task), trials, cycles, sweep_trials, mujoco_c, seed)
    make_answer_folder(folder)
    refuse_unwritable(folder / "gaits.json")
    results = []
    for result in measure(plan, robot, devices, lambda text: typer.echo(text, err=True)):
        results.append(result)
        print(json.dumps(result.figures), flush=True)
        write_json(folder / "gaits.json", [r.figures for r in results])
    given = {"--trials": trials, "--cycles": cycles, "--sweep-trials": sweep_trials, "--seed": seed}
    given |= {"--no-mujoco-c": not mujoco_c, "--model": model, "--task": task}
    line = command_line(("bench", "gaits", *(names or ())), given)
    write_gait_benchmark_report(folder / "report.html", results, robot.numbers, line)
