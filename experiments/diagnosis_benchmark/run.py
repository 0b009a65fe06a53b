"""The benchmark as one job: make the logs, ask every method, keep each answer, resume where it was stopped."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from experiments.diagnosis_benchmark.methods import METHODS, answers
from experiments.diagnosis_benchmark.score import confusions, table
from experiments.effects.bench import GRAVITY_LOAD
from experiments.effects.library import LIBRARY
from experiments.errors import UserError
from experiments.files import read_json, write_json
from experiments.independent_plant.cases import benchmark
from experiments.independent_plant.generate import generate
from experiments.measurement.gather import model_for
from experiments.measurement.intake import LogFault, read_checked
from experiments.model import nominal_model
from experiments.run_folder import make_answer_folder

MAX_BYTES = 50_000_000


def run(
    folder: Path, size: int, seed: int, duration: float, workers: int, say: Callable[[str], None]
) -> dict[str, Any]:
    """Figures of every method, over `size` cases; what lies in the folder already is not done again.

    Raises UserError if the folder holds another benchmark.
    """
    _claim(folder, {"size": size, "seed": seed, "duration": duration})
    sealed = folder / "truth.json"
    if not sealed.exists():
        generate(benchmark(seed, size, duration), folder / "logs", sealed, workers, say)
    truth = read_json(sealed, MAX_BYTES)["cases"]
    found = {}
    for number, (name, case) in enumerate(truth.items(), 1):
        kept = folder / "answers" / f"{name}.json"
        if not kept.exists():
            kept.parent.mkdir(parents=True, exist_ok=True)
            write_json(kept, answer(folder / "logs" / f"{name}.csv.gz", [e["effect"] for e in case["effects"]]))
            say(f"{number}/{len(truth)} logs diagnosed")
        found[name] = read_json(kept, MAX_BYTES)
    result = {
        "cases": len(truth),
        "methods": [table(truth, found, method) for method in METHODS],
        "wrong": confusions(truth, found),
    }
    write_json(folder / "table.json", result)
    return result


def answer(path: Path, hidden: list[str]) -> dict[str, Any]:
    """All methods on one log; a log that is refused is an answer too."""
    try:
        log = read_checked(path, None, nominal_model())
        model = model_for(log, nominal_model())
        library = dict(LIBRARY) if model.joint is None else dict(LIBRARY) | {GRAVITY_LOAD.name: GRAVITY_LOAD}
        return answers(log, model, library, hidden)
    except LogFault as fault:
        return {"diagnosis": fault.answer()}
    except UserError as error:
        return {"diagnosis": {"verdict": "data_fault", "text": str(error), "effects": []}}


def _claim(folder: Path, settings: dict[str, Any]) -> None:
    make_answer_folder(folder)
    note = folder / "benchmark.json"
    if note.exists() and read_json(note, MAX_BYTES) != settings:
        raise UserError(
            f"{folder} holds another benchmark: {json.dumps(read_json(note, MAX_BYTES))}; choose a new folder."
        )
    write_json(note, settings)
