"""Numbers on the command line that are none are refused before any work, whatever range they are to lie in."""

from typing import get_args, get_type_hints

import pytest
import typer
from typer.testing import CliRunner

from experiments.cli import commands
from experiments.cli.options import finite

FLOATS = [
    ["tune", "squat_jump", "--alpha"],
    ["robustness", "nowhere", "--gate"],
    ["play", "air", "--duration"],
    ["play", "air", "--noise"],
    ["sweep", "--task", "squat_jump", "--output", "o", "--alpha"],
    ["sweep", "--task", "squat_jump", "--output", "o", "--hours"],
    ["bench", "diagnosis", "--duration"],
    ["bench", "gradients", "--seconds"],
]


@pytest.fixture(scope="module")
def app() -> typer.Typer:
    made = typer.Typer()
    made.callback()(lambda: None)
    commands.register(made)
    return made


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "many"])
@pytest.mark.parametrize("words", FLOATS, ids=" ".join)
def test_an_option_that_is_no_number_is_refused(app: typer.Typer, words: list[str], value: str, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ended = CliRunner().invoke(app, [*words, value])
    assert ended.exit_code == 2 and not any(tmp_path.iterdir())
    assert "Invalid value" in ended.output and "Traceback" not in ended.output


def test_every_float_option_asks_for_a_finite_number(app: typer.Typer) -> None:
    def functions(group: typer.Typer):
        yield from (command.callback for command in group.registered_commands)
        for below in group.registered_groups:
            yield from functions(below.typer_instance)

    floats = []
    for function in functions(app):
        for name, hint in get_type_hints(function, include_extras=True).items():
            kind, *extras = get_args(hint) if hasattr(hint, "__metadata__") else (hint,)
            if kind is float or float in get_args(kind):
                floats.append(name)
                assert extras and extras[0].callback is finite, f"{function.__name__}: {name}"
    assert sorted(floats) == sorted(words[-1].removeprefix("--") for words in FLOATS)
