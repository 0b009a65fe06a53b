"""Write the logs of a list of cases, and the sealed truth in one file elsewhere.

    python -m experiments.independent_plant.generate --folder runs/benchmark --truth runs/truth.json --size 300

The folder gets case_0001.csv.gz and case_0001.json and so on; nothing in it tells what was hidden.
"""

import dataclasses
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from experiments.errors import UserError
from experiments.files import write_json
from experiments.independent_plant.bench_bodies import nominal_load
from experiments.independent_plant.cases import benchmark
from experiments.independent_plant.logs import bench_info, columns, robot_info, write_log
from experiments.independent_plant.numbers import KINDS
from experiments.independent_plant.plant import Recording
from experiments.independent_plant.runner import Case, batches, record
from experiments.independent_plant.strength import needs_twin, strength

BATCH = 32  # logs side by side in one process
TRIES = 3  # a robot that falls is drawn again, with another motion and noise
RETRY_SEED = 50_000


def generate(
    cases: Sequence[Case],
    folder: Path,
    truth: Path,
    workers: int = 2,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, dict]:
    """Write all logs into `folder` and what they hide into the file `truth`; returns the truth.

    Raises UserError if the truth would lie beside the logs, where a diagnosis could read it.
    """
    folder, truth = Path(folder), Path(truth)
    if folder.resolve() in truth.resolve().parents:
        raise UserError(f"The truth must not lie in the folder of the logs: choose another place than {truth}.")
    groups = batches(cases, BATCH)
    sealed: dict[str, dict] = {}
    began = time.monotonic()
    if workers == 1:
        for group in groups:
            sealed |= write_batch([cases[i] for i in group], [i + 1 for i in group], folder)
            progress(f"{len(sealed)}/{len(cases)} logs, {time.monotonic() - began:.0f} s")
    else:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            jobs = [pool.submit(write_batch, [cases[i] for i in g], [i + 1 for i in g], folder) for g in groups]
            for job in as_completed(jobs):
                sealed |= job.result()
                progress(f"{len(sealed)}/{len(cases)} logs, {time.monotonic() - began:.0f} s")
    sealed = dict(sorted(sealed.items()))
    truth.parent.mkdir(parents=True, exist_ok=True)
    write_json(truth, {"schema_version": 1, "cases": sealed})
    return sealed


def write_batch(cases: Sequence[Case], numbers: Sequence[int], folder: Path) -> dict[str, dict]:
    """Run cases of one platform side by side and write their logs; `numbers` name the files."""
    cases, sealed = list(cases), {}
    left = list(range(len(cases)))
    for attempt in range(TRIES):
        recording = record([cases[i] for i in left])
        twins = [i for i in left if any(needs_twin(effect) for effect in cases[i].effects)]
        twin = record([dataclasses.replace(cases[i], effects=()) for i in twins]) if twins else None
        again = []
        for log, i in enumerate(left):
            if recording.fallen[log] and attempt + 1 < TRIES:
                cases[i] = dataclasses.replace(cases[i], seed=cases[i].seed + RETRY_SEED)
                again.append(i)
                continue
            name = f"case_{numbers[i]:04d}"
            write_case(folder / name, cases[i], recording, log)
            against = _one(twin, twins.index(i)) if i in twins and twin is not None else None
            sealed[name] = _truth(cases[i], recording, log, against)
        left = again
        if not left:
            break
    return sealed


def _one(recording: Recording, log: int) -> dict[str, np.ndarray]:
    return {name: values[log] for name, values in recording.true.items()}


def write_case(path: Path, case: Case, recording: Recording, log: int = 0) -> None:
    """Write the log of a case that is one of a recording's batch: `<path>.csv.gz` and `<path>.json`."""
    signals = list(recording.signals)
    drive = case.bench_drive
    if drive is None:
        info = robot_info(case.platform, case.sensors, signals)
    else:
        info = bench_info(nominal_load(drive), drive, case.sensors, signals, case.period)
    write_log(path, columns(recording, log, case.column), info, case.period)


def _truth(case: Case, recording: Recording, log: int, twin: dict[str, np.ndarray] | None) -> dict:
    """What the scorer needs to know of one case."""
    drive = case.bench_drive
    effects = []
    for effect in case.effects:
        known = effect.family.checked(effect.parameters)
        seen = effect if drive is None else dataclasses.replace(effect, where=drive if drive in KINDS else "all")
        effects.append(
            {
                "effect": effect.effect,
                "where": effect.where if drive is None else "axis",
                "parameters": {key: {"value": value, "unit": effect.family.units[key]} for key, value in known.items()},
                "scaled_parameter": effect.family.scaled,
                "strength": strength(seen, recording, log, twin),
                "in_library": effect.family.library,
            }
        )
    return {
        "group": case.group,
        "effects": effects,
        "motion": case.motion,
        "experiment": case.platform.removesuffix("_rigid"),
        "richness": case.richness,
        "noise": case.sensors.noise,
        "jitter": case.sensors.jitter,
        "velocity_phase": case.velocity_phase,
        "numbers_off": {key: list(value) for key, value in case.off.items()},
        "bodies_off": {key: np.asarray(value).tolist() for key, value in dataclasses.asdict(case.bodies).items()},
        "load_off": list(case.load_off),
        "seed": case.seed,
        "fallen": bool(recording.fallen[log]),
    }


def main(
    folder: Annotated[Path, typer.Option(help="Where the logs go.")],
    truth: Annotated[Path, typer.Option(help="The sealed truth, one file outside that folder.")],
    size: Annotated[int, typer.Option(help="Number of cases.")] = 300,
    seed: Annotated[int, typer.Option(help="The same seed gives the same logs.")] = 0,
    duration: Annotated[float, typer.Option(help="Length of each log, s.")] = 8.0,
    workers: Annotated[int, typer.Option(help="Processes.")] = 2,
) -> None:
    """Make logs with hidden effects on a second, independent StarlETH."""
    try:
        generate(benchmark(seed, size, duration), folder, truth, workers, typer.echo)
    except UserError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from None


if __name__ == "__main__":
    typer.run(main)
