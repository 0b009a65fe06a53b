"""All subcommands, each in a file of its own."""

import typer

from experiments.cli import tune


def register(app: typer.Typer) -> None:
    """Add every subcommand to the command line."""
    for module in (tune,):
        module.register(app)
