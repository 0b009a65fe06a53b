"""`starleth play`: a log of a robot to practise on, with an effect hidden in it."""

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import finite

HELP = """A log of a second, independent StarlETH (MuJoCo C), with what you hide in it: a robot to practise on.

MOTION is air, air_torque, squat or hops, or a command file for legs in the air, such as next_experiment.csv.

    starleth play air --hide "backlash@LH_KFE half_width=0.02" -o log
    starleth diagnose log.csv.gz
"""


def register(app: typer.Typer) -> None:
    app.command("play", help=HELP)(command)


def command(
    motion: Annotated[str, typer.Argument(help="air, air_torque, squat, hops, or a command file.")],
    hide: Annotated[
        list[str] | None, typer.Option("--hide", help='"effect@place parameter=number …"; may be repeated.')
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Log to write, without its ending.")] = Path("log"),
    duration: Annotated[float, typer.Option(min=2.0, max=120.0, callback=finite, help="Of a motion, s.")] = 8.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the motion and the noise.")] = 0,
    noise: Annotated[
        float, typer.Option(min=0.0, max=100.0, callback=finite, help="Times the usual sensors' noise.")
    ] = 1.0,
) -> None:
    from experiments.files import refuse_unwritable
    from experiments.independent_plant.practice import parse_hidden, practise

    hidden = [parse_hidden(text) for text in hide or ()]
    output = Path(str(output).removesuffix(".gz").removesuffix(".csv"))
    table = Path(f"{output}.csv.gz")
    refuse_unwritable(table)
    if practise(motion, hidden, output, duration, seed, noise):
        typer.echo("The robot fell; its log goes on to the end. Hide less, or take another motion or seed.", err=True)
    typer.echo(f"Written to {table}; next: starleth diagnose {table}", err=True)
