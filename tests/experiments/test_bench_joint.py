"""A rigid joint on a bench: efforts in closed form for a given motion, so that what is hidden is known exactly."""

import json

import numpy as np
import pytest

from experiments.effects.bench import GRAVITY_LOAD
from experiments.effects.library import LIBRARY
from experiments.measurement.compare import compare
from experiments.measurement.diagnose import diagnose
from experiments.measurement.gather import model_for
from experiments.measurement.learn import learn
from experiments.measurement.log import BenchJoint, Log, SignalTable
from experiments.model import load_model, nominal_model, save_model

PERIOD = 1e-3
INERTIA, VISCOUS, GRAVITY = 0.3, 0.4, 2.0
COULOMB, BIAS = 0.35, 0.12  # N m that the model does not know of
ENCODER, TORQUE = 2e-6, 0.02  # rad, N m of noise
GEARED = dict(LIBRARY) | {GRAVITY_LOAD.name: GRAVITY_LOAD}


def bench_log(coulomb: float = 0.0, bias: float = 0.0, rows: int = 8000) -> Log:
    """A sum of sines; J a + b v + G sin q + coulomb sgn v + bias |v|, held for a row as a drive holds it."""
    rng = np.random.default_rng(5)
    time = np.arange(rows) * PERIOD
    tones = [(0.9, 0.31), (0.5, 0.77), (0.2, 1.9), (0.08, 3.3)]

    def course(t, k):
        terms = [a * (2 * np.pi * f) ** k * np.sin(2 * np.pi * f * t + f + k * np.pi / 2) for a, f in tones]
        return np.sum(terms, 0)

    middle = time + 0.5 * PERIOD  # the effort is held from this row to the next
    q, v, a = (course(middle, k) for k in range(3))
    effort = INERTIA * a + VISCOUS * v + GRAVITY * np.sin(q) + coulomb * np.sign(v) + bias * np.abs(v)
    table = lambda x: SignalTable(("axis",), x[:, None])  # noqa: E731
    signals = {
        "joint_position": table(course(time, 0) + ENCODER * rng.standard_normal(rows)),
        "applied_torque": table(effort + TORQUE * rng.standard_normal(rows)),
    }
    joint = BenchJoint(name="axis", inertia=INERTIA, viscous_friction=VISCOUS, gravity_load=GRAVITY)
    noise = {"joint_position": ENCODER, "applied_torque": TORQUE}
    return Log("joint", "bench", PERIOD, noise, joint, time, signals, name="bench")


@pytest.fixture(scope="module")
def faulty() -> Log:
    return bench_log(COULOMB, BIAS)


def test_the_right_model_lacks_nothing() -> None:
    log = bench_log()
    found = diagnose([log], model_for(log, nominal_model()), GEARED, lambda text: None)
    assert found.verdict == "none" and not found.effects
    assert found.answer["fit_percent"][0]["all"] > 98.0


def test_both_hidden_frictions_are_named_and_measured(faulty) -> None:
    found = diagnose([faulty], model_for(faulty, nominal_model()), GEARED, lambda text: None)
    named = {entry["effect"]: entry for entry in found.answer["effects"]}
    assert set(named) == {"coulomb_friction", "direction_dependent_viscous_friction"}
    assert {entry["where"] for entry in named.values()} == {"axis"}
    assert named["coulomb_friction"]["parameters"]["torque"]["value"] == pytest.approx(COULOMB, rel=0.02)
    assert named["direction_dependent_viscous_friction"]["parameters"]["coefficient"]["value"] == pytest.approx(
        BIAS, rel=0.05
    )
    errors = [found.answer["effects"][0]["held_out_error_before"], found.answer["effects"][-1]["held_out_error_after"]]
    assert errors[0] > 3.0 * errors[1] and errors[1] < 1.5


def test_a_learned_model_makes_the_error_fall(faulty, tmp_path) -> None:
    nominal = model_for(faulty, nominal_model())
    wanted = [("coulomb_friction", "axis"), ("direction_dependent_viscous_friction", "axis")]
    learned, _, _ = learn([faulty], nominal, GEARED, wanted)
    save_model(tmp_path / "model.json", learned)
    again = load_model(tmp_path / "model.json")
    assert json.loads((tmp_path / "model.json").read_text())["joint"]["name"] == "axis"
    before, after = (compare(faulty, model, GEARED) for model in (nominal, again))
    assert after.worst.over_noise < 0.2 * before.worst.over_noise
    assert after.channels[0].fit > before.channels[0].fit
