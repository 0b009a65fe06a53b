"""Options: numbers that are none and options that would be ignored are refused; results keep what repeats them."""

import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import get_args, get_type_hints

import pytest
import typer
from typer.testing import CliRunner

from experiments.cli import commands
from experiments.cli.options import finite
from experiments.command_line import LONGEST, command_line
from experiments.errors import UserError

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


def test_a_command_that_is_kept_can_be_pasted_into_a_shell() -> None:
    options = {"--model": "my model.json", "--task": None, "--effects": [Path("a;b.py"), Path("c.py")], "--seed": 0}
    line = command_line(("replay", Path("runs/it's")), options | {"--no-mujoco-c": True, "--nominal": False})
    words = ["starleth", "replay", "runs/it's", "--model", "my model.json", "--effects", "a;b.py", "--effects", "c.py"]
    assert shlex.split(line) == [*words, "--seed", "0", "--no-mujoco-c"]
    with pytest.raises(UserError, match="give shorter paths"):
        command_line(("replay", "a" * LONGEST), {})


def test_a_search_names_the_files_that_its_replay_needs(app: typer.Typer, tmp_path, monkeypatch) -> None:
    from experiments.cli import tune
    from experiments.export import replay_line
    from experiments.model import nominal_model, save_model
    from experiments.tasks.definition import load_task

    monkeypatch.chdir(tmp_path)
    save_model(Path("my model.json"), nominal_model())
    Path("jump.json").write_text(load_task("squat_jump").model_dump_json())
    lines = []
    for name in ("start_jax", "whole_loops", "terminate_as_interrupt"):
        monkeypatch.setattr(tune, name, lambda *_: None)
    monkeypatch.setattr(tune, "_search", lambda options, folder: lines.append(replay_line(options, folder)))
    for words in (["squat_jump"], ["jump.json", "--model", "my model.json", "-o", "a run"]):
        CliRunner().invoke(app, ["tune", *words], catch_exceptions=False)
    assert lines == [
        "starleth replay runs/squat_jump",
        "starleth replay 'a run' --model 'my model.json' --task jump.json",
    ]


def test_the_gaits_report_tells_all_that_repeats_it(app: typer.Typer, tmp_path, monkeypatch) -> None:
    from experiments.cli import bench_gaits
    from experiments.gait_benchmark import run
    from experiments.model import nominal_model, save_model
    from experiments.reports import gait_benchmark

    monkeypatch.chdir(tmp_path)
    save_model(Path("my model.json"), nominal_model())
    lines = []
    for name in ("start_jax", "whole_loops"):
        monkeypatch.setattr(bench_gaits, name, lambda *_: None)
    monkeypatch.setattr(run, "measure", lambda *_: [])
    monkeypatch.setattr(gait_benchmark, "write_gait_benchmark_report", lambda *arguments: lines.append(arguments[-1]))
    words = "bench gaits pronk --sweep-trials 0 --seed 7 --no-mujoco-c --model".split()
    CliRunner().invoke(app, [*words, "my model.json"], catch_exceptions=False)
    counts = "--trials 100 --cycles 20 --sweep-trials 0 --seed 7 --no-mujoco-c"
    assert lines == [f"starleth bench gaits pronk {counts} --model 'my model.json'"]


def test_robustness_on_another_model_than_the_jumps_says_so(capsys) -> None:
    from experiments.cli.robustness import _say_other_model

    def plan(on: str):
        return SimpleNamespace(
            file=SimpleNamespace(model_hash="aa"), options=SimpleNamespace(model=SimpleNamespace(hash=lambda: on))
        )

    _say_other_model(plan("aa"))
    assert capsys.readouterr() == ("", "")
    _say_other_model(plan("bb"))
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and "tuned on the model aa and is tried on bb" in shown.err


@pytest.mark.parametrize("words", [["--where", "LF_KFE"], ["--parameter", "coefficient=1"]], ids=" ".join)
def test_an_effect_is_described_only_with_its_name(app: typer.Typer, words: list[str], tmp_path, monkeypatch) -> None:
    from experiments.cli import bench_learned

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(bench_learned, "start_jax", lambda _: pytest.fail("ignored"))
    ended = CliRunner().invoke(app, ["bench", "learned", *words])
    assert isinstance(ended.exception, UserError) and "give it by --effect" in str(ended.exception)
