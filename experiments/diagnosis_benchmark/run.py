"""The benchmark as one job: make the logs, ask every method, keep each answer, resume where it was stopped."""

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from experiments.diagnosis_benchmark.methods import METHODS, answers
from experiments.diagnosis_benchmark.score import confusions, table
from experiments.effects.library import LIBRARY
from experiments.errors import UserError
from experiments.files import read_json, write_json
from experiments.independent_plant.cases import benchmark
from experiments.independent_plant.generate import generate
from experiments.measurement.answer import DATA_FAULT, answer_of
from experiments.measurement.evidence.gather import library_for, model_for
from experiments.measurement.intake import LogFault, read_checked
from experiments.model import nominal_model
from experiments.run_folder import make_answer_folder

MAX_BYTES = 50_000_000


def run(
    folder: Path,
    size: int,
    seed: int,
    duration: float,
    methods: Sequence[str],
    workers: int,
    say: Callable[[str], None],
) -> dict[str, Any]:
    """Figures of these METHODS over `size` cases; what lies in the folder already is not done again.

    Raises UserError if the folder holds another benchmark, or for a method that there is not.
    """
    strange = [name for name in methods if name not in METHODS]
    if strange or not methods:
        raise UserError(f"No method '{', '.join(strange)}'; the methods are {', '.join(METHODS)}.")
    _claim(folder, {"size": size, "seed": seed, "duration": duration})
    sealed = folder / "truth.json"
    if not sealed.exists():
        generate(benchmark(seed, size, duration), folder / "logs", sealed, workers, say)
    truth = read_json(sealed, MAX_BYTES)["cases"]
    found = {}
    for number, (name, case) in enumerate(truth.items(), 1):
        found[name] = _kept_answers(folder, name, [e["effect"] for e in case["effects"]], methods)
        say(f"{number}/{len(truth)} logs diagnosed")
    result = {
        "cases": len(truth),
        "methods": [table(truth, found, method) for method in METHODS if method in methods],
        "wrong": confusions(truth, found),
    }
    write_json(folder / "table.json", result)
    return result


def _kept_answers(folder: Path, name: str, hidden: Sequence[str], methods: Sequence[str]) -> dict[str, Any]:
    """Answers to one log, those in the folder and those that are new; `asked` tells which methods had their turn."""
    path = folder / "answers" / f"{name}.json"
    kept = read_json(path, MAX_BYTES) if path.exists() else {}
    fresh = [method for method in methods if method not in kept.get("asked", ())]
    if fresh:
        began = time.monotonic()
        kept |= answer(folder / "logs" / f"{name}.csv.gz", hidden, fresh)
        kept["asked"] = [*kept.get("asked", ()), *fresh]
        kept["seconds"] = kept.get("seconds", 0.0) + round(time.monotonic() - began, 1)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, kept)
    return kept


def answer(path: Path, hidden: Sequence[str], methods: Sequence[str]) -> dict[str, Any]:
    """These methods on one log; a log that is refused is an answer too."""
    try:
        log = read_checked(path, None, nominal_model())
        model = model_for(log, nominal_model())
        return answers(log, model, library_for(model, LIBRARY), hidden, methods)
    except LogFault as fault:
        return {"diagnosis": fault.answer()}
    except UserError as error:
        return {"diagnosis": answer_of(DATA_FAULT, str(error), "record another log")}


def _claim(folder: Path, settings: dict[str, Any]) -> None:
    make_answer_folder(folder)
    note = folder / "benchmark.json"
    if note.exists() and read_json(note, MAX_BYTES) != settings:
        raise UserError(
            f"{folder} holds another benchmark: {json.dumps(read_json(note, MAX_BYTES))}; choose a new folder."
        )
    write_json(note, settings)
