"""All subcommands, each in a file of its own."""

import typer

from experiments.cli import bench, collect, measuring, play, replay, robustness, sweep, tune


def register(app: typer.Typer) -> None:
    """Add every subcommand to the command line."""
    for module in (tune, replay, robustness, measuring, play, bench, sweep, collect):
        module.register(app)
