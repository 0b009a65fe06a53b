"""Rows that no replay tells: which they are, when they are left out, and what is found without them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.independent_plant.library import Effect
from experiments.independent_plant.practice import practise
from experiments.measurement.diagnose import diagnose
from experiments.measurement.evidence import untold as untold_module
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.log_evidence import Point
from experiments.measurement.evidence.robot_evidence import RobotEvidence
from experiments.measurement.evidence.untold import untold, without_untold
from experiments.measurement.fits.fit_types import Placed, Refitted
from experiments.measurement.intake import read_checked
from experiments.measurement.selection import judged_rows as module
from experiments.measurement.selection.belief import Finalist
from experiments.measurement.selection.judged_rows import Judged, judged_rows, set_aside
from experiments.model import nominal_model
from mjx_starleth.names import JOINT_NAMES

ROWS, JOINTS = 100, 2
POINT = Point(np.zeros(1), np.zeros(JOINTS), np.zeros(0))
FITS = ["chosen", "tried", "blown up"]
BEGUN = (Placed("bus_voltage_sag", "all", {"resistance": 2.5, "switching": 1.0}),)


def drive_of(predict: Callable[[np.ndarray], np.ndarray], noisier: np.ndarray | None = None) -> SimpleNamespace:
    """Drives of a strength and a shape, with the prediction that more noise on the links makes."""
    return SimpleNamespace(
        atoms=SimpleNamespace(strengths=lambda: np.array([True, False])[: 2 if noisier is None else 1]),
        predict=lambda xs, shifts: predict(xs),
        play=lambda log, motion, xs, shifts: predict(xs) if motion == "as noisy" or noisier is None else noisier[None],
        renoised=("as noisy", "noisier"),
        log=None,
        rows=ROWS,
        floor=np.full((JOINTS, 3), 0.05),
    )


def test_a_row_is_untold_where_noise_moves_its_prediction_far_and_so_are_its_neighbours() -> None:
    moved = np.zeros((ROWS, JOINTS, 3))
    moved[40, 1, 2], moved[60, 1, 2], moved[80, 0, 2] = 20.0, -0.75, 0.3  # 400 floors, 15, and 6
    drive = drive_of(lambda xs: np.zeros((len(xs), ROWS, JOINTS, 3)), moved)
    rows, joints, channels = np.nonzero(untold(drive, POINT.x, POINT.shift))
    assert rows.tolist() == [38, 39, 40, 41, 42, 58, 59, 60, 61, 62]
    assert set(joints) == {1} and set(channels) == {2}


def test_a_row_is_untold_where_a_hundredth_of_an_effect_moves_it_far_to_one_side() -> None:
    strength, shape = 5.0, 3.0

    def predict(xs: np.ndarray) -> np.ndarray:
        found = np.zeros((len(xs), ROWS, JOINTS, 3))
        found[:, :, 0, 0] = 100.0 * xs[:, :1]  # far, to both sides alike
        found[:, 70, 1, 2] = 3.0 * (xs[:, 0] > strength)
        found[:, 30, 1, 2] = 3.0 * (xs[:, 1] != shape)
        return found

    rows, joints, channels = np.nonzero(untold(drive_of(predict), np.array([strength, shape]), POINT.shift))
    assert rows.tolist() == [68, 69, 70, 71, 72] and set(joints) == {1} and set(channels) == {2}


def test_what_is_no_number_is_not_told() -> None:
    blown_up = np.zeros((ROWS, JOINTS, 3))
    blown_up[20, 0, 1] = np.nan
    drive = drive_of(lambda xs: np.zeros((len(xs), ROWS, JOINTS, 3)), blown_up)
    assert np.flatnonzero(untold(drive, POINT.x, POINT.shift).any((1, 2))).tolist() == [18, 19, 20, 21, 22]


@dataclass(frozen=True)
class Told:
    used: np.ndarray


def robot(used: np.ndarray) -> RobotEvidence:
    return RobotEvidence("log", None, Told(used), None, 1, 0.0025, None)


def test_what_is_told_stays_and_what_was_never_logged_stays_out(monkeypatch: pytest.MonkeyPatch) -> None:
    thrown, used = np.zeros((ROWS, JOINTS, 3), bool), np.ones((ROWS, JOINTS, 3))
    used[:, 0, 2] = 0.0
    log = robot(used)
    monkeypatch.setattr(untold_module, "untold", lambda *_: thrown)
    assert without_untold(log, POINT) is log
    thrown[40:43] = True
    left = without_untold(log, POINT).drive.used
    assert not left[40:43].any() and (np.delete(left, slice(40, 43), 0) == np.delete(used, slice(40, 43), 0)).all()


def fit(name: str) -> Refitted:
    point = POINT._replace(x=np.array([FITS.index(name)]))
    return Refitted((), np.zeros(0), np.zeros(0), (point,), (np.zeros(1),), None)


def log_of(residuals: dict[str, np.ndarray]) -> SimpleNamespace:
    """A log whose replays leave these residuals (rows,) in each channel, by the name of the fit."""
    by_point = {FITS.index(name): r[:, None, None] * np.ones((1, JOINTS, 3)) for name, r in residuals.items()}
    drive = SimpleNamespace(used=np.ones((ROWS, JOINTS, 3)))
    return SimpleNamespace(drive=drive, drive_residual=lambda points: np.stack([by_point[int(p.x[0])] for p in points]))


@pytest.mark.parametrize(("moves", "told"), [(True, True), (False, False)])
def test_rows_are_left_out_if_they_hold_most_of_what_the_best_fit_leaves_and_noise_moves_them(
    monkeypatch: pytest.MonkeyPatch, moves: bool, told: bool
) -> None:
    few, calm = np.full(ROWS, 1.1), np.ones(ROWS)
    few[50:52] = 300.0
    blown_up = np.where(np.arange(ROWS) < ROWS - 1, 0.0, np.nan)
    log, without = log_of({"chosen": np.full(ROWS, 20.0), "tried": few, "blown up": blown_up}), log_of({"tried": calm})
    aside = []
    log.without = lambda rows: aside.append(rows) or without
    monkeypatch.setattr(module, "without_untold", lambda log, point: without if moves else log)
    monkeypatch.setattr(module, "from_afar", lambda logs, fit, nominal: BEGUN)
    monkeypatch.setattr(module, "refit", lambda logs, effects, nominal, start: replace(start, effects=effects))
    tried = [Finalist(None, fit(name), 0.0) for name in ("tried", "blown up")]
    selection = SimpleNamespace(fit=fit("chosen"), refitted=[tried], nominal=())
    found = judged_rows([log], selection)
    assert (found is not None) == told
    assert np.flatnonzero(aside[0]).tolist() == [48, 49, 50, 51, 52, 53]  # its worst rows
    if told:
        assert found == Judged((without,), BEGUN)


def test_a_misfit_that_is_spread_over_a_log_is_judged_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "without_untold", lambda log, point: pytest.fail("nothing to leave out"))
    log = log_of({"chosen": np.full(ROWS, 20.0)})
    assert judged_rows([log], SimpleNamespace(fit=fit("chosen"), refitted=[])) is None
    bodies_only = SimpleNamespace(drive=None)
    assert judged_rows([bodies_only], SimpleNamespace(fit=fit("chosen"), refitted=[])) is None


def test_it_is_told_how_much_is_not_judged() -> None:
    log = log_of({})
    fewer = SimpleNamespace(drive=SimpleNamespace(used=log.drive.used.copy()))
    fewer.drive.used[:5] = 0.0
    bodies_only = SimpleNamespace(drive=None)
    assert set_aside([log, bodies_only], [log, bodies_only]) == ""
    assert set_aside([log, bodies_only], [fewer, bodies_only]).startswith("5.0% of what the drives tell is not judged")


def test_the_supply_is_looked_for_as_one() -> None:
    layout = Atoms(tuple(LIBRARY.values()), JOINT_NAMES)
    assert layout.places(LIBRARY["bus_voltage_sag"]) == ("all",)
    assert "LH_KFE" in layout.places(LIBRARY["backlash"])


@pytest.mark.slow
@pytest.mark.parametrize("resistance", [1.6, 2.5])
def test_a_supply_that_collapses_in_hops_is_named(tmp_path, resistance: float) -> None:
    log = tmp_path / "log"
    practise("hops", [Effect("bus_voltage_sag", "all", {"resistance": resistance})], log)
    read = read_checked(log.with_suffix(".csv.gz"), None, nominal_model())
    found = diagnose([read], nominal_model(), LIBRARY, lambda text: None)
    (entry,) = found.answer["effects"]
    assert (entry["effect"], entry["where"]) == ("bus_voltage_sag", "all")
    assert found.answer["unexplained_fraction"] < 0.1
