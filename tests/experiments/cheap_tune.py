"""A search that is tune in all but the robot: run folder, checkpoints, parameter file; costs milliseconds.

    python cheap_tune.py TASK --seed=N --output=DIR [--generations=N] [--pause=SECONDS] [--die=FILE] …

`--die=FILE`: be killed in the third generation of the first attempt (FILE tells that there was one).
"""

import os
import signal
import sys
import time
from pathlib import Path

import jax
import numpy as np

import es
from experiments import parameter_file
from experiments.cli.signals import terminate_as_interrupt
from experiments.errors import UserError
from experiments.parameter_file import write_parameters
from experiments.parameter_schema import Metric, Spread
from experiments.run_folder import open_run

SIZE, POPULATION = 4, 6
INTERRUPTED = 130


def space() -> es.ParameterSpace:
    """A box of equal ranges."""
    return es.ParameterSpace(tuple(es.Parameter(f"p{i}", "m", -1.0, 2.0, 0.5) for i in range(SIZE)))


def run(
    folder: Path,
    seed: int = 0,
    generations: int = 6,
    pause: float = 0.0,
    die: Path | None = None,
    interrupt_in: int | None = None,
) -> str:
    """Search, export, finish; the checksum of what is exported. Raises UserError, es.SearchInterrupted."""
    calls = []

    def evaluate(stage, x, key):
        calls.append(0)
        time.sleep(pause)
        if die is not None and len(calls) == 3 and not die.exists():
            die.write_text("killed once")
            os.kill(os.getpid(), signal.SIGKILL)
        if len(calls) == interrupt_in:
            raise KeyboardInterrupt
        noise = np.asarray(jax.random.normal(key, (SIZE,)))
        return np.sum((x - 0.3 - 0.01 * noise) ** 2, axis=-1), None

    with open_run(folder, "tune", {"seed": seed, "generations": generations}) as opened:
        if opened.finished:
            return parameter_file.read_parameters(opened / "parameters.json", allow_ungated=True).checksum
        checkpointer = es.Checkpointer(opened / "checkpoints", {"seed": seed}, seconds_between=0.0, notify=print)
        stages = [es.Stage("loose", generations // 2), es.Stage("full", generations - generations // 2)]
        settings = es.SearchSettings(population=POPULATION)
        try:
            found = es.search(evaluate, space(), stages, settings, jax.random.key(seed), checkpointer=checkpointer)
        except es.CheckpointError as error:
            raise UserError(f"{error}.") from None
        written = write_parameters(opened / "parameters.json", **fields(found, seed))
        opened.mark_finished()
    return written.checksum


def fields(found: es.SearchResult, seed: int) -> dict:
    """A parameter file of the result; nothing in it depends on when or where it was found."""
    cost = float(found.best_cost)
    values = space().named(found.best)
    return {
        "task": "cheap",
        "robot": "starleth",
        "model_hash": "0" * 16,
        "parameters": [parameter_file.parameter(name, value, "m", -1.0, 2.0) for name, value in values.items()],
        "metrics": {
            "cost": Metric(value=cost, unit="-", spread=Spread(mean=cost, std=0.0, low=cost, high=cost)),
            "success": Metric(value=True, unit="-", spread=Spread(mean=0.75, std=0.1, low=0.0, high=1.0)),
            "apex_height": Metric(value=values["p0"], unit="m"),
        },
        "cost_terms": {"cost": cost},
        "drive": "ideal",
        "seed": seed,
        "search": {"generations": len(found.history), "population": POPULATION},
        "versions": {},
        "created": "2026-01-01T00:00:00Z",
        "command": "none",
    }


def main(words: list[str]) -> int:
    """As the command line would: one sentence and exit code 2 for bad input."""
    options = dict(word[2:].split("=", 1) for word in words if word.startswith("--"))
    terminate_as_interrupt()
    if words[0].startswith("unknown"):
        print(f"starleth: No task '{words[0]}'.", file=sys.stderr)
        return 2
    if words[0].startswith("broken"):
        raise RuntimeError("the sky is falling")
    die = Path(f"{options['die']}_{options['seed']}") if "die" in options else None
    try:
        run(
            Path(options["output"]),
            int(options["seed"]),
            int(options.get("generations", 6)),
            float(options.get("pause", 0.0)),
            die,
        )
    except UserError as error:
        print(f"starleth: {error}", file=sys.stderr)
        return 2
    except (es.SearchInterrupted, KeyboardInterrupt):
        return INTERRUPTED
    return 0


if __name__ == "__main__":
    from experiments.sweep.member import die_with_parent

    die_with_parent()
    sys.exit(main(sys.argv[1:]))
