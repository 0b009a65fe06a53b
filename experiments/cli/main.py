"""The command `starleth`. Each subcommand lives in its own file and imports what it needs when it runs."""

import sys

import typer

from experiments.errors import UserError

app = typer.Typer(
    name="starleth",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Find, stress and trust motions for a series-elastic quadruped, and learn which effect its model lacks.",
    epilog="First steps:  starleth tune squat_jump   then   starleth replay runs/squat_jump",
)


def main() -> None:
    """Entry point: a UserError is one sentence on stderr and exit code 2."""
    from experiments.cli import commands

    app.callback()(lambda: None)
    commands.register(app)
    try:
        app()
    except UserError as error:
        print(f"starleth: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("starleth: interrupted.", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
