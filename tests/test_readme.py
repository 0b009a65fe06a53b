"""What the README shows is what there is: its commands are understood, its example effect is the package's file."""

import re
import shlex
from importlib import resources
from pathlib import Path

import pytest
import typer

from experiments.cli import commands

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def commands_shown() -> list[str]:
    """Each line of the README's shell blocks that calls `starleth`, without comment and pipe."""
    blocks = re.findall(r"```sh\n(.*?)```", README, re.S)
    lines = [line for block in blocks for line in block.splitlines() if "starleth" in line]
    calls = [re.search(r"(?:^|[ /])starleth (.*)", line.split("  #")[0].split(" | ")[0]) for line in lines]
    return sorted({call.group(1).strip() for call in calls if call})


@pytest.fixture(scope="module")
def program():
    app = typer.Typer()
    commands.register(app)
    return typer.main.get_command(app)


@pytest.mark.parametrize("words", commands_shown())
def test_every_command_shown_is_understood(program, words: str) -> None:
    name, *rest = shlex.split(words)
    command = program.commands[name]
    if rest and rest[0] in getattr(command, "commands", {}):
        command, rest = command.commands[rest[0]], rest[1:]
    known = {option for parameter in command.params for option in parameter.opts}
    asked = {word.split("=")[0] for word in rest if re.match(r"--?[a-z]", word)}
    assert asked <= known, f"`starleth {words}`: no option {', '.join(sorted(asked - known))}"


def test_the_example_effect_is_the_file_in_the_package() -> None:
    text = (resources.files("experiments") / "examples" / "cogging.py").read_text(encoding="utf-8")
    assert f"```python\n{text.rstrip()}\n```" in README


def test_ci_runs_the_test_command_of_the_readme() -> None:
    script = (Path(__file__).parents[1] / ".ci" / "run").read_text(encoding="utf-8")
    assert ".venv/bin/pytest\n" in README and "\npytest\n" in script
