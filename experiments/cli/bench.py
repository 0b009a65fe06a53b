"""`starleth bench`: speed side by side with MuJoCo C; what the diagnosis is worth; what the gaits bear."""

import json
import shlex
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli import bench_gradients, bench_learned, bench_risk
from experiments.cli.options import (
    DevicesOption,
    ModelOption,
    SeedOption,
    available_cores,
    finite,
    start_jax,
    whole_loops,
)

HELP = """Measure speed side by side with MuJoCo C in one run, on all cores; one JSON line per entry.

    starleth bench                    all entries (about two minutes, mostly compiling)
    starleth bench --rounds 20        more rounds; the best of each entry counts
    starleth bench diagnosis          how often the diagnosis is right, on hidden effects of an independent plant
    starleth bench learned            what a learned effect is worth in the next jump on an independent plant
    starleth bench gaits              how long the gaits keep going, what throws them over, MuJoCo C
    starleth bench gradients          CMA-ES, gradients and both at equal wall time
    starleth bench risk               a plain and a robust search on perturbed trials that neither has seen
"""
GAITS = """How long do the gaits keep going, and what throws them over?

For each gait that comes with the program, or each run or parameters.json given: unseen perturbed trials in the full
model with estimated state, beside the gait's initial guess; survival over sideways pushes, unperceived obstacles,
slopes with a full turn, and friction; and the same gait in MuJoCo C with its own contact. One JSON line per gait;
gaits.json and report.html in the output folder.

    starleth bench gaits                                   all (about 15 minutes on two cores)
    starleth bench gaits walking_trot runs/my_trot         these
    starleth bench gaits --sweep-trials 0 --no-mujoco-c    only the unseen trials
"""
DIAGNOSIS = """How often is the diagnosis right?

Makes logs with hidden effects on a second plant that shares no code with the model, diagnoses each, and compares with
the sealed truth; beside it what one would do instead. Resumes: what the folder holds is not done again.

    starleth bench diagnosis --size 20         a glance (half an hour on two cores)
    starleth bench diagnosis --size 300        the whole (hours)
    starleth bench diagnosis --methods diagnosis    without what one would do instead, three times as fast
"""


def register(app: typer.Typer) -> None:
    bench = typer.Typer(help=HELP, invoke_without_command=True)
    bench.callback()(speed)
    bench.command("diagnosis", help=DIAGNOSIS)(diagnosis)
    bench.command("gaits", help=GAITS)(gaits)
    bench.command("gradients", help=bench_gradients.HELP)(bench_gradients.gradients)
    bench.command("learned", help=bench_learned.HELP)(bench_learned.learned)
    bench.command("risk", help=bench_risk.HELP)(bench_risk.risk)
    app.add_typer(bench, name="bench")


def speed(
    context: typer.Context,
    model: ModelOption = None,
    devices: DevicesOption = available_cores(),  # noqa: B008
    batch: Annotated[
        int | None, typer.Option(min=1, help="Environments per entry; default: the fastest found.")
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help="Rounds in which the entries take turns.")] = 5,
) -> None:
    if context.invoked_subcommand is not None:
        return
    whole_loops()
    start_jax(devices)
    from experiments import bench
    from experiments.model import load_model

    for line in bench.measure(bench.entries(load_model(model), devices, batch), rounds):
        print(json.dumps(line), flush=True)


def diagnosis(
    size: Annotated[int, typer.Option(min=8, help="Number of logs.")] = 20,
    seed: SeedOption = 0,
    duration: Annotated[float, typer.Option(min=4.0, max=60.0, callback=finite, help="Length of each log, s.")] = 8.0,
    methods: Annotated[
        str, typer.Option(help="Which of diagnosis, parameters, best_single, sparse, removed; with commas between.")
    ] = "diagnosis,parameters,best_single,sparse,removed",
    folder: Annotated[Path, typer.Option("--output", "-o", help="Folder for logs, answers and table.")] = Path(
        "runs/bench_diagnosis"
    ),
) -> None:
    start_jax()
    from rich.console import Console
    from rich.table import Table

    from experiments.diagnosis_benchmark.run import run

    workers = available_cores()
    names = [name.strip() for name in methods.split(",") if name.strip()]
    result = run(folder, size, seed, duration, names, workers, lambda text: typer.echo(text, err=True))
    figures = Table(title=f"{result['cases']} logs, hits of cases")
    columns = list(result["methods"][0])
    for column in columns:
        figures.add_column(column.replace("_", " "))
    for row in result["methods"]:
        figures.add_row(*(value if isinstance(value, str) else f"{value[0]}/{value[1]}" for value in row.values()))
    Console(stderr=True).print(figures)
    for line in result["wrong"]:
        typer.echo(line, err=True)
    print(json.dumps(result))


def gaits(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[GAIT]...", help="Gaits, runs or parameter files.")
    ] = None,
    trials: Annotated[int, typer.Option(min=1, max=100_000, help="Unseen trials of each gait.")] = 100,
    cycles: Annotated[int, typer.Option(min=1, max=1000, help="Strides of an unseen trial.")] = 20,
    sweep_trials: Annotated[
        int, typer.Option(min=0, max=10_000, help="Trials at each size of each disturbance; 0: none.")
    ] = 16,
    mujoco_c: Annotated[bool, typer.Option(help="Replay each gait in MuJoCo C.")] = True,
    model: ModelOption = None,
    devices: DevicesOption = available_cores(),  # noqa: B008
    folder: Annotated[Path, typer.Option("--output", "-o", help="Folder for gaits.json and report.html.")] = Path(
        "runs/bench_gaits"
    ),
) -> None:
    whole_loops()
    start_jax(devices)
    from experiments.files import refuse_unwritable, write_json
    from experiments.gait_benchmark.run import Plan, find_motions, measure
    from experiments.model import load_model
    from experiments.reports.gait_benchmark import write_gait_benchmark_report
    from experiments.run_folder import make_answer_folder

    robot = load_model(model)
    plan = Plan(find_motions(names or (), robot), trials, cycles, sweep_trials, mujoco_c)
    make_answer_folder(folder)
    refuse_unwritable(folder / "gaits.json")
    results = []
    for result in measure(plan, robot, devices, lambda text: typer.echo(text, err=True)):
        results.append(result)
        print(json.dumps(result.figures), flush=True)
        write_json(folder / "gaits.json", [r.figures for r in results])
    line = shlex.join(["starleth", "bench", "gaits", *(names or ()), "--trials", str(trials), "--cycles", str(cycles)])
    write_gait_benchmark_report(folder / "report.html", results, robot.numbers, line)
