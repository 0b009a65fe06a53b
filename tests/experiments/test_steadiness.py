"""An effect whose strength would have to change along the log is another law, and is not named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rigid_bench import GEARED, SILENT, bench_log

from experiments.effects.library import LIBRARY
from experiments.independent_plant.practice import parse_hidden, practise
from experiments.measurement.checks.check import check
from experiments.measurement.diagnose import diagnose
from experiments.measurement.evidence.gather import gather, model_for
from experiments.measurement.evidence.robot_evidence import RobotEvidence
from experiments.measurement.evidence.states import states_of
from experiments.measurement.fits.fit_types import Placed
from experiments.measurement.fits.nominal import never_given
from experiments.measurement.fits.refit import refit
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.log_reader import read_log
from experiments.measurement.logs.noise_floor import noise_of
from experiments.measurement.selection.steadiness import changes_in
from experiments.model import nominal_model

AIR = Path(__file__).parents[1] / "data" / "air_reference_1500ms.csv.gz"
WEAK = {"torque_constant": {"relative": -0.4}, "viscous_friction": {"coefficient": 1e-4}}


def fading(share: float) -> Log:
    """A bench joint with dry friction that falls (or grows) by a share of itself to both sides of the mean."""
    clean, rubs = bench_log(), bench_log(coulomb=0.35)
    ramp = np.linspace(1.0 + share, 1.0 - share, clean.rows)[:, None]
    without, with_it = (log.signals["applied_torque"] for log in (clean, rubs))
    effort = replace(without, values=without.values + ramp * (with_it.values - without.values))
    return replace(clean, signals={**clean.signals, "applied_torque": effort})


@pytest.mark.parametrize(("share", "verdict"), [(0.0, "explained"), (0.5, "unknown")])
def test_friction_that_fades_while_the_joint_runs_has_no_name(share: float, verdict: str) -> None:
    log = fading(share)
    assert check(log, {}) == []
    found = diagnose([log], model_for(log, nominal_model()), GEARED, SILENT)
    assert found.verdict == verdict, found.text
    names = [entry["effect"] for entry in found.answer["effects"]]
    assert names == (["coulomb_friction"] if verdict == "explained" else [])
    assert [one["state"] for one in found.answer["unsteady"]] == ([] if verdict == "explained" else ["time"])


@pytest.fixture(scope="module")
def air() -> RobotEvidence:
    log = read_log(AIR)
    model = nominal_model()
    return gather(log, model_for(log, model), LIBRARY, noise_of(log))


def with_a_law(air: RobotEvidence, placed: Placed, state: str | None) -> RobotEvidence:
    """A log whose drives have an effect that grows from nothing to twice its strength with a state."""
    start = air.start()
    there = start._replace(x=air.atoms.placed(start.x, [placed]))
    without, with_it = air.drive.predict(np.stack([start.x, there.x]), np.zeros((2, 12)))
    size = 1.0 if state is None else 1.0 + next(iter(states_of(air, air.start())))[state]
    drive = replace(air.drive, measured=air.drive.measured + size * (with_it - without))
    return replace(air, drive=drive)


@pytest.mark.parametrize(
    ("effect", "state"),
    [*(("torque_constant", state) for state in (None, "time", "position", "load")), ("viscous_friction", "speed")],
)
def test_a_drive_s_law_that_goes_with_a_state_is_told_by_that_state(air, effect: str, state: str | None) -> None:
    placed = Placed(effect, "LH_HFE", WEAK[effect])
    log, nominal = with_a_law(air, placed, state), never_given(nominal_model(), air.atoms.effects)
    fit = refit([log], [placed], nominal)
    found = changes_in([log], fit, nominal)
    assert [(one.effect, one.where, one.state) for one in found] == ([(effect, "LH_HFE", state)] if state else [])
    assert all(0.3 < one.share < 2.0 for one in found)


def test_a_change_that_takes_little_of_a_large_rest_accuses_the_rest(air) -> None:
    """What no effect of the fit explains lends some of itself to any change; LH_HFE's law here is steady enough."""
    placed = Placed("torque_constant", "LH_HFE", WEAK["torque_constant"])
    nominal = never_given(nominal_model(), air.atoms.effects)
    log = with_a_law(air, placed, "time")
    assert changes_in([log], refit([log], [placed], nominal), nominal)
    loud = with_a_law(log, Placed("torque_constant", "RF_KFE", {"relative": -0.6}), None)
    assert changes_in([loud], refit([loud], [placed], nominal), nominal) == []


def test_the_noise_of_a_torque_sensor_is_no_change_with_the_load(tmp_path) -> None:
    """Legs in the air bear hardly more than the sensors' noise: a load that had it went with any stiffness."""
    practise("air", [parse_hidden("spring_stiffness change=0.5")], tmp_path / "stiff", duration=3.0)
    log = read_log(tmp_path / "stiff.csv.gz")
    evidence = gather(log, nominal_model(), LIBRARY, noise_of(log))
    nominal = never_given(nominal_model(), evidence.atoms.effects)
    fit = refit([evidence], [Placed("spring_stiffness", "all", {"relative": 0.5})], nominal)
    assert fit.effects[0].parameters["relative"] == pytest.approx(0.5, abs=0.02)
    assert changes_in([evidence], fit, nominal) == []


def test_several_logs_judge_together(air) -> None:
    placed = Placed("torque_constant", "LH_HFE", WEAK["torque_constant"])
    nominal = never_given(nominal_model(), air.atoms.effects)
    one, both = with_a_law(air, placed, "time"), with_a_law(air, placed, None)
    (alone,) = changes_in([one], refit([one], [placed], nominal), nominal)
    (together,) = changes_in([one, both], refit([one, both], [placed], nominal), nominal)
    assert together.state == "time" and 0.3 * alone.share < together.share < alone.share
