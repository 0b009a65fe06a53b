"""`starleth bench`: speed side by side with MuJoCo C; the other benchmarks stand in files of their own."""

import json
from typing import Annotated

import typer

from experiments.cli import bench_diagnosis, bench_gaits, bench_gradients, bench_learned, bench_risk
from experiments.cli.options import DevicesOption, ModelOption, available_cores, start_jax, whole_loops

HELP = """Measure speed side by side with MuJoCo C in one run, on all cores; one JSON line per entry.

    starleth bench                    all entries (about two minutes, mostly compiling)
    starleth bench --rounds 20        more rounds; the best of each entry counts
    starleth bench diagnosis          how often the diagnosis is right, on hidden effects of an independent plant
    starleth bench learned            what a learned effect is worth in the next jump on an independent plant
    starleth bench gaits              how long the gaits keep going, what throws them over, MuJoCo C
    starleth bench gradients          CMA-ES, gradients and both at equal wall time
    starleth bench risk               a plain and a robust search on perturbed trials that neither has seen
"""


def register(app: typer.Typer) -> None:
    bench = typer.Typer(help=HELP, invoke_without_command=True)
    bench.callback()(speed)
    bench.command("diagnosis", help=bench_diagnosis.HELP)(bench_diagnosis.diagnosis)
    bench.command("gaits", help=bench_gaits.HELP)(bench_gaits.gaits)
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
