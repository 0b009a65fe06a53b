"""Sweeps: derived names, hostile files refused, finished work kept, dead members retried or named; three executors."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cheap_tune
import pytest
from typer.testing import CliRunner

from experiments.errors import UserError
from experiments.reports.sweep import write_sweep_report
from experiments.run_folder import open_run
from experiments.sweep.collect import collect, summary
from experiments.sweep.definition import MAX_MEMBERS, Sweep, load_sweep, parse_seeds, parse_sweep
from experiments.sweep.executors import Place, open_executor
from experiments.sweep.member import TUNE, read_outcome, result_of, run_member
from experiments.sweep.run import Extra, array_script, job_of, prepare, run_all, settings_of, sweep_in, unfinished

CHEAP = (sys.executable, cheap_tune.__file__)
PATIENCE = 300.0  # s for what takes seconds, on a machine with ten times more work than cores


TWO = Sweep(tasks=("cheap",), seeds="0-1")


@pytest.fixture(scope="module", autouse=True)
def one_cache(tmp_path_factory):
    """The cheap searches of this file compile once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path_factory.getbasetemp() / "cache_of_sweeps"))
        patch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        yield


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> tuple[Path, list]:
    """Folder of two searches over two workers, that of seed 1 killed in its first attempt; what was told. Only read."""
    folder = tmp_path_factory.mktemp("finished")
    (folder / "died_0").write_text("not this one")
    failed, told = run_sweep(folder / "sweep", TWO, Place("local", 2, 1), extra(f"--die={folder}/died"))
    assert not failed
    return folder / "sweep", told


def extra(*words: str) -> Extra:
    """Members are cheap searches; the words are for all of them."""
    return Extra(devices=1, program=(*CHEAP, "cheap", *words))


def run_sweep(folder: Path, sweep: Sweep, place: Place, words: Extra) -> tuple[dict[str, str], list]:
    """What `starleth sweep` does: the failed members, and what was told."""
    told = []
    with open_run(folder, "sweep", settings_of(sweep)):
        prepare(folder)
        todo, damaged = unfinished(folder, sweep.members())
        assert not damaged
        with open_executor(place, folder) as executor:
            failed = run_all(folder, sweep, todo, words, executor, lambda *event: told.append(event))
    return failed, told


def values(folder: Path, sweep: Sweep) -> dict[str, dict[str, float]]:
    return {member.name: result_of(folder, member.name).values() for member in sweep.members()}


# --- the sweep and its file


def test_members_are_tasks_times_models_times_seeds_with_derived_names():
    sweep = parse_sweep(
        {"tasks": ["squat_jump", "a/b/my jump.json"], "models": ["x.json", "nominal"], "seeds": "3,5-6"}, "s"
    )
    names = [member.name for member in sweep.members()]
    assert len(names) == len(set(names)) == sweep.count == 12
    assert names[0] == "squat_jump.x.seed3" and names[-1] == "my_jump.nominal.seed6"
    last = sweep.tune_arguments(sweep.members()[-1])
    assert last == ["a/b/my jump.json", "--seed=6", "--drive=full"]
    assert "--model=x.json" in sweep.tune_arguments(sweep.members()[0])


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ([], "must be a JSON object"),
        ({}, "tasks"),
        ({"tasks": []}, "tasks"),
        ({"tasks": ["a"], "colour": 1}, "colour"),
        ({"tasks": ["--effects=evil.py"]}, "tasks.0"),
        ({"tasks": ["a"], "models": ["-o"]}, "models.0"),
        ({"tasks": ["a\nb"]}, "tasks.0"),
        ({"tasks": ["a", "x/a"]}, "called 'a'; rename"),
        ({"tasks": ["a"], "seeds": "1-"}, "no number or range"),
        ({"tasks": ["a"], "seeds": "5-4"}, "do not rise"),
        ({"tasks": ["a"], "seeds": "1,1"}, "twice"),
        ({"tasks": ["a"], "seeds": "0-99999999"}, "more than"),
        ({"tasks": ["a", "b"], "seeds": f"0-{MAX_MEMBERS - 1}"}, "make several sweeps"),
        ({"tasks": ["a"], "output": "/etc"}, "output"),
        ({"tasks": ["a"], "effects": ["evil.py"]}, "effects"),
        ({"tasks": ["a"], "generations": float("nan")}, "generations"),
    ],
)
def test_a_bad_sweep_file_is_one_sentence(tmp_path, content, match):
    with pytest.raises(UserError, match=match) as refusal:
        parse_sweep(content, "sweep.json")
    assert "\n" not in str(refusal.value) and str(refusal.value).endswith(".")


@pytest.mark.parametrize("source", ["../../../etc/passwd", "/etc/../x.json", "..", "a\\b", "é/ü.json", "a" * 999])
def test_no_name_leaves_the_members_folder(source):
    (member,) = Sweep(tasks=(source,)).members()
    assert set(member.name) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-.")
    assert not member.name.startswith(".") and "/" not in member.name and len(member.name) < 200


def test_paths_in_a_file_are_relative_to_it(tmp_path):
    (tmp_path / "s.json").write_text(json.dumps({"tasks": ["squat_jump", "t.json"], "models": ["m/x.json"]}))
    sweep = load_sweep(tmp_path / "s.json")
    assert sweep.tasks == ("squat_jump", str(tmp_path / "t.json")) and sweep.models == (str(tmp_path / "m/x.json"),)


def test_seeds():
    assert parse_seeds("0-3, 7,9-9") == (0, 1, 2, 3, 7, 9)


# --- running


def test_a_killed_member_is_tried_once_more_and_finished_ones_are_not_run_again(finished):
    folder, told = finished
    kills = {outcome.name: final for outcome, final in told if outcome.exit_code == -signal.SIGKILL}
    assert kills == {"cheap.nominal.seed1": False}
    assert read_outcome(folder, "cheap.nominal.seed1").attempt == 2
    before = {path: path.stat().st_mtime_ns for path in (folder / "members").rglob("*.json")}
    assert run_sweep(folder, TWO, Place("local", 2, 1), extra()) == ({}, [])
    assert before == {path: path.stat().st_mtime_ns for path in before}


@pytest.mark.slow
def test_eight_searches_over_two_workers_survive_kills_and_are_not_run_again(tmp_path):
    """The members of seeds 2 and 5 are killed with SIGKILL in their first attempt and continue in their second."""
    sweep = Sweep(tasks=("cheap",), seeds="0-7")
    place = Place("local", workers=2, devices=1)
    for seed in (0, 1, 3, 4, 6, 7):
        (tmp_path / f"died_{seed}").write_text("not this one")
    failed, told = run_sweep(tmp_path / "sweep", sweep, place, extra(f"--die={tmp_path}/died"))
    assert not failed
    killed = {outcome.name: final for outcome, final in told if outcome.exit_code == -signal.SIGKILL}
    assert killed == {"cheap.nominal.seed2": False, "cheap.nominal.seed5": False}
    assert read_outcome(tmp_path / "sweep", "cheap.nominal.seed5").attempt == 2

    whole, _ = run_sweep(tmp_path / "whole", Sweep(tasks=("cheap",), seeds="2"), place, extra())
    assert not whole
    assert result_of(tmp_path / "sweep", "cheap.nominal.seed2") == result_of(tmp_path / "whole", "cheap.nominal.seed2")

    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "sweep" / "members").rglob("*.json")}
    assert run_sweep(tmp_path / "sweep", sweep, place, extra()) == ({}, [])
    assert before == {path: path.stat().st_mtime_ns for path in before}


@pytest.mark.slow
def test_a_member_that_fails_is_tried_once_more_and_named_and_bad_input_is_not(tmp_path):
    sweep = Sweep(tasks=("broken", "unknown"), seeds="0")
    words = Extra(devices=1, program=CHEAP)
    failed, told = run_sweep(tmp_path, sweep, Place("local", 2, 1), words)
    assert [outcome.name for outcome, _ in told].count("broken.nominal.seed0") == 2 and len(told) == 3
    assert "the sky is falling" in failed["broken.nominal.seed0"]
    assert failed["unknown.nominal.seed0"] == "No task 'unknown'."
    rows = collect(tmp_path, sweep)
    assert [row.status for row in rows] == ["failed", "failed"] and "sky" in rows[0].sentence


def test_damaged_results_are_named_and_left_alone(finished, tmp_path):
    folder = Path(shutil.copytree(finished[0], tmp_path / "sweep"))
    victim = folder / "members" / "cheap.nominal.seed1" / "parameters.json"
    victim.write_bytes(victim.read_bytes()[:-40])
    todo, damaged = unfinished(folder, TWO.members())
    assert not todo and "Delete" in damaged["cheap.nominal.seed1"]
    assert [row.status for row in collect(folder, TWO)] == ["finished", "damaged"]


@pytest.mark.slow
def test_an_interrupted_sweep_stops_its_members_and_goes_on(tmp_path):
    """SIGTERM to the whole command, as a cluster sends it; then the folder alone is given."""
    sweep = Sweep(tasks=("cheap",), seeds="0-1")
    code = (
        "import sys, experiments.sweep.run as r\n"
        f"program = {(*CHEAP, 'cheap', '--pause=0.3', '--generations=40')!r}\n"
        "new = r.Extra.__init__\n"
        "r.Extra.__init__ = lambda self, devices, effects=(): new(self, devices, effects, program)\n"
        "from experiments.cli.main import main\nmain()"
    )
    words = ["sweep", "--task", "cheap", "--seeds", "0-1", "--workers", "2", "--output", str(tmp_path / "s")]
    process = subprocess.Popen([sys.executable, "-c", code, *words], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + PATIENCE
    checkpoints = [tmp_path / "s" / "members" / m.name / "checkpoints" for m in sweep.members()]
    while not all(any(path.glob("generation_*")) for path in checkpoints):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    _, words = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130 and "goes on" in words and "Traceback" not in words
    assert sweep_in(tmp_path / "s") == sweep
    # nothing was left running: the folders can be taken at once
    for member in sweep.members():
        job = job_of(tmp_path / "s", sweep, member, extra("--generations=40"))
        assert run_member(job).exit_code == 0
    assert len(values(tmp_path / "s", sweep)) == 2


@pytest.mark.slow
def test_submitit_runs_members_as_jobs(tmp_path):
    pytest.importorskip("submitit")
    sweep = Sweep(tasks=("cheap",), seeds="0-1")
    failed, _ = run_sweep(tmp_path, sweep, Place("submitit", 2, 1, cluster="local", hours=1), extra())
    assert not failed and len(values(tmp_path, sweep)) == 2
    assert (tmp_path / "submitit").stat().st_mode & 0o077 == 0


@pytest.mark.slow
def test_dask_runs_members_on_a_cluster_and_survives_the_kill_of_a_worker(tmp_path):
    distributed = pytest.importorskip("distributed")
    sweep = Sweep(tasks=("cheap",), seeds="0-3")
    local = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": 50}
    with distributed.LocalCluster(**local) as cluster:
        place = Place("dask", 2, 1, scheduler=cluster.scheduler_address)
        with ThreadPoolExecutor(1) as killer:
            killed = killer.submit(kill_a_worker, cluster, tmp_path / "members")
            failed, _ = run_sweep(tmp_path, sweep, place, extra("--pause=0.2", "--generations=10"))
            assert killed.result()
    assert not failed
    run_sweep(tmp_path / "local", sweep, Place("local", 2, 1), extra("--generations=10"))
    assert values(tmp_path, sweep) == values(tmp_path / "local", sweep)


def kill_a_worker(cluster, members: Path) -> bool:
    """SIGKILL to the process of a Dask worker once a member is at work."""
    deadline = time.monotonic() + PATIENCE
    while not any(members.glob("*/checkpoints/generation_*")):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
    return True


def test_a_scheduler_that_is_not_there_is_one_sentence(tmp_path):
    pytest.importorskip("distributed")
    with (
        pytest.raises(UserError, match=r"cannot be reached"),
        open_executor(Place("dask", 1, 1, scheduler="nonsense://x"), tmp_path),
    ):
        pass


# --- the script for sbatch


def test_the_array_script_quotes_its_words_and_runs_one_member_each(tmp_path):
    folder = tmp_path / "a folder; with $HOME `x` 'quotes'"
    sweep = Sweep(tasks=("squat_jump",), seeds="0-2")
    text = array_script(folder, sweep, Extra(2), hours=1.5)
    assert "#SBATCH --array=0-2" in text and "#SBATCH --time=90" in text and text.startswith("#!/bin/sh\n")
    show = "import sys; print(sys.argv[1:])"
    script = text.replace(f"exec {sys.executable} -m experiments.cli.main", f"exec {sys.executable} -c '{show}'")
    (folder / "logs").mkdir(parents=True)
    subprocess.run(["sh", "-c", script], env=os.environ | {"SLURM_ARRAY_TASK_ID": "1"}, check=True)
    words = (folder / "logs" / "task_1.log").read_text().strip()
    assert words == str(["sweep", str(folder), "--devices=2", "--only", "1"])


# --- collect


def test_collect_gathers_what_the_members_found(finished, tmp_path):
    rows = collect(finished[0], TWO)
    found = summary(rows)
    costs = {row["name"]: row["cost"] for row in found["members"]}
    assert found["counts"]["finished"] == 2 and found["best"] == [min(costs, key=costs.get)]
    assert found["members"][0]["success_rate"] == 0.75
    assert found["members"][1]["values"] == values(finished[0], TWO)["cheap.nominal.seed1"]
    write_sweep_report(tmp_path / "report.html", tmp_path, rows)
    page = (tmp_path / "report.html").read_text()
    assert "cheap.nominal.seed1" in page and "default-src 'none'" in page


def test_a_member_called_like_a_script_is_only_text_in_the_report(tmp_path):
    sweep = Sweep(tasks=("</script><script>alert(1)</script>",))
    write_sweep_report(tmp_path / "report.html", tmp_path, collect(tmp_path, sweep))
    assert "<script>alert" not in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["sweep"], "Nothing to sweep"),
        (["sweep", "--task", "x"], "--output"),
        (["sweep", "s.json", "--seeds", "0-3", "--drive", "cheap", "-o", "o"], "leave --seeds and --drive away"),
        (["sweep", "s.json", "--task", "squat_jump", "--alpha", "0.5", "-o", "o"], "leave --task and --alpha away"),
        (["sweep", ".", "--generations", "9", "--trials", "2", "--risk", "cvar"], "--generations, --trials and --risk"),
        (["sweep", ".", "--population", "9", "--perturbations", "rough"], "--population and --perturbations away"),
        (["sweep", ".", "--output", "o"], "leave --output away"),
        (["sweep", "nowhere.json", "--output", "o"], "cannot read nowhere.json"),
        (["sweep", "--task", "x", "--output", "o", "--executor", "magic"], "No executor 'magic'"),
        (["sweep", "--task", "x", "--seeds", "a", "--output", "o"], "no number or range"),
        (["sweep", "--task", "no_such_task", "--output", "o"], "No task 'no_such_task'"),
        (["sweep", "--task", "squat_jump", "--model", "x.json", "--output", "o"], "x.json: no such file"),
        (["sweep", "--task", "squat_jump", "--perturbations", "x", "--output", "o"], "No perturbations 'x'"),
        (["sweep", "--task", "squat_jump", "--generations", "1", "--output", "o"], "1 generations are too few"),
        (["sweep", "--task", "squat_jump", "--alpha", "0.5", "--output", "o"], "takes no alpha"),
        (["collect", "nowhere"], "nowhere holds no sweep"),
    ],
)
def test_bad_input_on_the_command_line_is_one_sentence(tmp_path, monkeypatch, words, match):
    from experiments.cli import commands
    from experiments.cli.main import app

    monkeypatch.chdir(tmp_path)
    if not app.registered_commands:
        app.callback()(lambda: None)
        commands.register(app)
    result = CliRunner().invoke(app, words)
    assert isinstance(result.exception, UserError), result.output
    assert match in str(result.exception) and "\n" not in str(result.exception)
    assert not (tmp_path / "o").exists()


def test_a_cluster_that_is_not_there_is_one_sentence(tmp_path):
    pytest.importorskip("submitit")
    with (
        pytest.raises(UserError, match="submitit finds no cluster"),
        open_executor(Place("submitit", 1, 1, None, "no_such", 1.0), tmp_path),
    ):
        pass


@pytest.mark.slow
def test_a_sweep_of_real_jumps(tmp_path):
    """Two seeds of a short squat jump by the command line, one of them killed on the way."""
    assert TUNE[1:] == ("-m", "experiments.sweep.member", "tune")
    command = [sys.executable, "-m", "experiments.cli.main", "sweep", "--task", "squat_jump", "--generations", "4"]
    command += ["--population", "4", "--seeds", "0-1", "--workers", "2", "--output", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    again = subprocess.run([*command[:4], str(tmp_path)], capture_output=True, text=True)
    assert again.returncode == 0 and "2 of 2 members are finished already" in again.stderr
    assert subprocess.run([*command[:3], "collect", str(tmp_path)], capture_output=True).returncode == 0
    assert len(json.loads((tmp_path / "sweep.json").read_text())["best"]) == 1
