"""Motions that tell tied effects apart: within the robot's limits, and better than others on the drives' own replay."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller_jax.geometry import geometry_from_numbers
from experiments.effects import LIBRARY
from experiments.measurement.evidence.gather import gather
from experiments.measurement.excitation import FASTEST, excitations
from experiments.measurement.fits.fit_types import Placed
from experiments.measurement.fits.refit import refit
from experiments.measurement.logs.log_reader import read_log
from experiments.measurement.logs.noise_floor import noise_of
from experiments.measurement.next_experiment import next_experiment, separation, write_commands
from experiments.measurement.selection.elsewhere import Elsewhere
from experiments.measurement.selection.ladder import Selection
from experiments.model import nominal_model

DATA = Path(__file__).parents[1] / "data"
PERIOD = 2.5e-3
LIMITS = np.asarray(geometry_from_numbers(nominal_model().numbers.model_dump(mode="json")).position_limits, float)


@pytest.fixture(scope="module")
def tied():
    """Evidence of a short squat, and a friction that may be dry or viscous in one knee."""
    log = read_log(DATA / "squat_reference_1500ms.csv.gz")
    library = {name: LIBRARY[name] for name in ("coulomb_friction", "viscous_friction")}
    evidence = gather(log, nominal_model(), library, noise_of(log))
    fit = refit([evidence], (), (), iterations=1)
    dry = replace(fit, effects=(Placed("coulomb_friction", "LH_KFE", {"torque": 0.006}),))
    viscous = replace(fit, effects=(Placed("viscous_friction", "LH_KFE", {"coefficient": 4e-5}),))
    return evidence, dry, viscous


def test_without_ties_there_is_nothing_to_do(tied) -> None:
    evidence, dry, _ = tied
    found = next_experiment(
        [evidence], Selection(dry, (), Elsewhere([evidence], ()), winners=[dry], rivals=[[]]), nominal_model()
    )
    assert found.text == "" and found.excitation is None


def test_the_best_of_the_motions_is_chosen_and_written(tied, tmp_path) -> None:
    evidence, dry, viscous = tied
    found = next_experiment(
        [evidence], Selection(dry, (), Elsewhere([evidence], ()), winners=[dry], rivals=[[viscous]]), nominal_model()
    )
    assert "coulomb_friction@LH_KFE" in found.text and "viscous_friction@LH_KFE" in found.text
    rest = np.clip(
        evidence.drive.log.joint_position[: evidence.drive.rows].mean(0), LIMITS[:, 0] + 0.3, LIMITS[:, 1] - 0.3
    )
    sizes = {e.name: separation(evidence, dry, viscous, e) for e in excitations(LIMITS, rest, PERIOD)}
    assert found.excitation.name == max(sizes, key=sizes.get) and max(sizes.values()) > 1.0
    assert separation(evidence, dry, dry, found.excitation) < 1e-3, "nothing tells an effect from itself"
    write_commands(tmp_path / "next.csv", found.excitation, evidence.atoms.joint_names, PERIOD)
    rows = list(csv.DictReader((tmp_path / "next.csv").open()))
    assert len(rows) == len(found.excitation.position)
    assert float(rows[1]["time"]) == pytest.approx(PERIOD)
    assert float(rows[100]["command_position/LH_KFE"]) == pytest.approx(found.excitation.position[100, 8], abs=1e-6)


def test_motions_stay_within_limits_and_begin_at_rest() -> None:
    rest = np.clip(LIMITS.mean(1), LIMITS[:, 0] + 0.3, LIMITS[:, 1] - 0.3)
    for excitation in excitations(LIMITS, rest, PERIOD):
        q = excitation.position
        assert (q > LIMITS[:, 0]).all() and (q < LIMITS[:, 1]).all(), excitation.name
        np.testing.assert_allclose(q[[0, -1]], [rest, rest], atol=1e-9)
        assert np.abs(np.diff(q, axis=0) / PERIOD).max() < 2.0 * FASTEST
        assert np.ptp(q, axis=0).min() > 0.02, "every joint moves"
