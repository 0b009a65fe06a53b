"""Logs of joints on benches, made by the independent plant: at which rate they are judged, and which together."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.effects.library import LIBRARY
from experiments.independent_plant.generate import write_batch
from experiments.independent_plant.logs import write_log
from experiments.independent_plant.runner import Case
from experiments.measurement.compare import compare
from experiments.measurement.evidence.gather import library_for, model_for
from experiments.measurement.intake import read_checked
from experiments.measurement.logs.log_reader import read_log
from experiments.measurement.logs.resample import resample
from experiments.model import nominal_model

FAST = 1e-3  # s


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """case_0001: an elastic joint at the control period, case_0002: a rigid one at 1 kHz."""
    folder = tmp_path_factory.mktemp("benches")
    write_batch([Case("bench_KFE", seed=5, duration=3.0)], [1], folder)
    write_batch([Case("bench_rigid", seed=5, duration=3.0)], [2], folder)
    return folder


def test_an_elastic_joint_that_was_logged_faster_is_replayed_at_its_control_period(folder: Path) -> None:
    source = folder / "case_0001"
    log = resample(read_log(source.with_suffix(".csv.gz")), FAST)
    info = json.loads(source.with_suffix(".json").read_text()) | {"sample_period": FAST}
    table = {f"{signal}/axis": one.column("axis") for signal, one in log.signals.items()}
    write_log(folder / "fast", table, info, FAST)
    taken = read_checked(folder / "fast.csv.gz", None, nominal_model())
    assert taken.sample_period == 2.5e-3 and taken.rows == pytest.approx(0.4 * log.rows, abs=1)
    model = model_for(taken, nominal_model())
    found = compare(taken, model, library_for(model, LIBRARY))
    assert found.worst.over_noise < 1.3, found.in_words()


def test_a_rigid_joint_keeps_the_rate_of_its_log(folder: Path) -> None:
    taken = read_checked(folder / "case_0002.csv.gz", None, nominal_model())
    assert (taken.sample_period, taken.rows) == (FAST, 3000)
    assert read_checked(folder / "case_0002.csv.gz", None, model_for(taken, nominal_model())).sample_period == FAST


@pytest.mark.parametrize(
    "words", [("diagnose",), ("learn", "--effect", "coulomb_friction")], ids=lambda words: words[0]
)
def test_logs_of_different_joints_are_not_judged_by_one_model(folder: Path, tmp_path: Path, words) -> None:
    info = json.loads((folder / "case_0002.json").read_text())
    info["joint"]["inertia"] *= 2.0
    (tmp_path / "other.json").write_text(json.dumps(info))
    shutil.copy(folder / "case_0002.csv.gz", tmp_path / "other.csv.gz")
    logs = [str(path / f"{name}.csv.gz") for path, name in ((folder, "case_0002"), (tmp_path, "other"))]
    starleth = [sys.executable, "-m", "experiments.cli.main"]
    ended = subprocess.run(
        [*starleth, *words, *logs, "--output", str(tmp_path / "model.json")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2 and "other is of another robot or joint than case_0002" in ended.stderr, ended.stderr
