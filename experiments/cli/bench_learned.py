"""`starleth bench learned`: a jump of the learned model against one of the nominal, on the robot's stand-in."""

import json
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import DevicesOption, SeedOption, available_cores, start_jax, whole_loops
from experiments.errors import UserError

HELP = """What is a learned effect worth in the next jump?

A second plant that shares no code with the model stands in for the robot, with a hidden effect. Its log (legs in the
air, or hops for what these do not show) is diagnosed and the model learns what was named. From a jump of the nominal
model the same search goes on, once on the nominal and once on the learned model; both jumps are replayed on that plant.
A jump is worth its height over the standing torso, and nothing if the robot falls. One JSON line for each effect: both
jumps as promised and as reached, `lost` (what the effect takes from the nominal jump on that plant), `won_back` (what
the learned jump has over the nominal one there) and the share of the two.

Hidden are, one after the other: a load of 3 kg in front, one of 2 kg behind, knee torque sensors that read 2 N m too
much (the nominal jump falls over with each), a load of 3 kg, torque sensors that read 15 % too much, springs 30 % too
soft and motors 15 % too weak (each takes 0.07 m or more). Friction in the gears, say, takes less than a centimetre:
then there is nothing to win back, and no share is given. Not all that is lost can be won back by knowing it: a load
stays heavy, weak motors weak, and a sensor that reads too much also lowers what the limits of the commanded torque let
through.

    starleth bench learned                                          all seven (about 40 minutes)
    starleth bench learned --effect joint_viscous_drag --parameter coefficient=1
"""


def learned(
    effect: Annotated[str | None, typer.Option(help="Hide this one, by its name in the second plant.")] = None,
    where: Annotated[str | None, typer.Option(help="Where it acts. Default: all.")] = None,
    parameter: Annotated[list[str] | None, typer.Option(help="name=value, may be repeated.")] = None,
    generations: Annotated[
        int, typer.Option(min=4, max=100_000, help="Of the first search; the one that goes on has half as many.")
    ] = 100,
    seed: SeedOption = 0,
    devices: DevicesOption = available_cores(),  # noqa: B008
    folder: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for logs, runs and results; what it holds is not done again.")
    ] = Path("runs/bench_learned"),
) -> None:
    if effect is None and (where is not None or parameter):
        raise UserError("--where and --parameter describe the effect that is hidden; give it by --effect.")
    whole_loops()
    start_jax(devices)
    from experiments.diagnosis_benchmark.beyond_log import HIDDEN, beyond_log
    from experiments.files import write_json
    from experiments.independent_plant.practice import parse_hidden

    own = None if effect is None else parse_hidden(" ".join((f"{effect}@{where or 'all'}", *(parameter or ()))))
    results = []
    for hidden in HIDDEN if own is None else (own,):
        results.append(beyond_log(folder, hidden, generations, seed, devices, lambda text: typer.echo(text, err=True)))
        print(json.dumps(results[-1]), flush=True)
    write_json(folder / "learned.json", {"results": results})
