"""What a log's bodies are judged by: noise makes no number look better, and feet that slide tell of the ground."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.effects import LIBRARY, Effect, Parameter
from experiments.effects.delay import LOOP_TIMING
from experiments.effects.link import BEARING_FRICTION
from experiments.independent_plant.generate import write_batch
from experiments.independent_plant.library import Effect as Hidden
from experiments.independent_plant.runner import Case
from experiments.independent_plant.sensors import SensorSettings
from experiments.measurement.compare import compare
from experiments.measurement.evidence.body_evidence import CHANNELS, FELT_BY_BODIES
from experiments.measurement.evidence.body_replay import BodyLog, body_log
from experiments.measurement.evidence.calm_log import calm_log
from experiments.measurement.evidence.gather import gather
from experiments.measurement.fits.fit_types import Placed
from experiments.measurement.fits.footprint import noise_at
from experiments.measurement.fits.nominal import never_given, timing
from experiments.measurement.fits.refit import refit
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.log_reader import read_log
from experiments.measurement.logs.noise_floor import noise_of
from experiments.model import nominal_model

DATA = Path(__file__).parents[1] / "data"
PERIOD = 2.5e-3
NOISE = {
    "base_position": 1e-3,
    "base_orientation": 1e-3,
    "joint_position": 1e-3,
    "base_linear_velocity": 0.01,
    "base_angular_velocity": 0.01,
    "joint_velocity": 0.05,
    "joint_torque": 0.1,
}


def effects(*names: str) -> dict[str, Effect]:
    return {name: LIBRARY[name] for name in names}


def noisy_motion(amplitude: float) -> tuple[BodyLog, BodyLog]:
    """Four seconds of joints that swing at 1.5 Hz, as they are and as sensors see them."""
    rows, rng = 1600, np.random.default_rng(1)
    time = np.arange(rows) * PERIOD
    w = 2 * np.pi * 1.5
    swing = amplitude * np.ones(12)
    q, u, du = np.zeros((rows, 19)), np.zeros((rows, 18)), np.zeros((rows, 18))
    q[:, 3] = 1.0
    q[:, 7:], u[:, 6:] = swing * np.sin(w * time)[:, None], swing * w * np.cos(w * time)[:, None]
    du[:, 6:] = -swing * w * w * np.sin(w * time)[:, None]
    torque = 2.0 + 3.0 * q[:, 7:]
    true = BodyLog(q, u, du, torque, np.ones((rows, 4)))
    noisy_u = u.copy()
    noisy_u[:, 6:] += NOISE["joint_velocity"] * rng.standard_normal((rows, 12))
    seen = true._replace(u=noisy_u, du=np.gradient(noisy_u, PERIOD, axis=0))
    return true, BodyLog(*(np.asarray(table, np.float32) for table in seen))


def test_a_calm_log_keeps_the_motion_and_loses_the_noise() -> None:
    true, seen = noisy_motion(0.4)
    calm, inner = calm_log(seen, PERIOD, NOISE), slice(100, -100)
    size = lambda x: np.sqrt((x[inner] ** 2).mean())  # noqa: E731
    assert size(calm.u - true.u) < 0.35 * size(seen.u - true.u)
    assert size(calm.du - true.du) < 0.1 * size(seen.du - true.du)
    assert size(calm.du - true.du) < 0.05 * size(true.du)
    assert size(calm.torque - true.torque) < 2e-3 * size(true.torque)
    assert (calm.contact == seen.contact).all()


def test_a_motion_of_nothing_but_noise_is_calm() -> None:
    _, seen = noisy_motion(0.0)
    assert np.square(calm_log(seen, PERIOD, NOISE).du).mean() < 0.05**2 * np.square(seen.du).mean()


@pytest.fixture(scope="module")
def squat():
    log = read_log(DATA / "squat_reference_1500ms.csv.gz")
    return gather(log, nominal_model(), effects("link_mass", BEARING_FRICTION.name), noise_of(log))


def without(log: Log, *signals: str) -> Log:
    return replace(log, signals={name: table for name, table in log.signals.items() if name not in signals})


@pytest.mark.parametrize("missing", ["base_position", "base_orientation"])
def test_of_a_robot_whose_torso_was_not_seen_only_the_drives_are_judged(missing: str) -> None:
    log = without(read_log(DATA / "squat_reference_1500ms.csv.gz"), missing)
    found = compare(log, nominal_model(), effects("link_mass"))
    assert found.misfit.body is None and found.explained and "Only the drives" in found.in_words()


def test_velocities_that_were_not_logged_come_from_the_pose_with_its_noise() -> None:
    log = read_log(DATA / "squat_reference_1500ms.csv.gz")
    shorter = without(log, "base_angular_velocity", "base_linear_velocity")
    logged, derived = body_log(log).u[:, :6], body_log(shorter).u[:, :6]
    noise = noise_of(shorter)
    for axes, name in ((slice(0, 3), "base_linear_velocity"), (slice(3, 6), "base_angular_velocity")):
        error = (derived - logged)[5:-5, axes]
        assert error.std() == pytest.approx(noise[name], rel=0.2) and abs(error.mean()) < 0.1 * noise[name]
    found = compare(shorter, nominal_model(), effects("link_mass"))
    assert found.explained, found.in_words()


def test_lighter_links_do_not_make_the_noise_smaller(squat) -> None:
    """Of a torso that hardly turns, yaw residuals are noise times inertia: hips of half the mass took 38 % of it."""
    off = squat.atoms.off()
    light = squat.atoms.placed(off, [Placed("link_mass", "HAA", {"relative": -0.5})])
    nominal, lighter = squat.body.residual(np.stack([off, light]))
    yaw = CHANNELS.index("torso_torque/z")
    power = lambda rows: (rows[:, yaw] ** 2).sum()  # noqa: E731
    assert power(lighter) > 0.9 * power(nominal)


def test_the_load_of_a_bearing_rubs_and_no_robot_is_accused_of_it(squat) -> None:
    *clock, bearings = never_given(nominal_model(), squat.atoms.effects)
    assert (bearings.effect, bearings.where) == (BEARING_FRICTION.name, "all")
    found = refit([squat], (), (*clock, bearings)).nominal[-1]
    assert found < 0.5 * bearings.deviation, "the reference plant's bearings do not rub"


def test_the_bearings_of_the_independent_plant_are_found(tmp_path) -> None:
    case = Case("squat", seed=3, duration=3.0, sensors=SensorSettings(0.3))
    write_batch([case], [1], tmp_path)
    log = read_log(tmp_path / "case_0001.csv.gz")
    evidence = gather(log, nominal_model(), effects(BEARING_FRICTION.name), noise_of(log))
    found = refit([evidence], (), never_given(nominal_model(), evidence.atoms.effects)).nominal[-1]
    assert found == pytest.approx(nominal_model().numbers.drive.bearing_friction_per_radial_load, rel=0.15)


def test_feet_that_slide_in_hops_tell_how_slippery_the_ground_is(tmp_path) -> None:
    slippery = Hidden("ground_friction", "feet", {"change": -0.6})
    case = Case("hops", effects=(slippery,), seed=4, duration=3.0, sensors=SensorSettings(1.0))
    write_batch([case], [1], tmp_path)
    log = read_log(tmp_path / "case_0001.csv.gz")
    evidence = gather(log, nominal_model(), effects("ground_friction"), noise_of(log))
    assert evidence.body.used[:, -4:].sum() > 3
    placed = (Placed("ground_friction", "feet", {"relative": -0.3}),)
    (found,) = refit([evidence], placed, timing(evidence.atoms.effects)).effects
    assert found.parameters["relative"] == pytest.approx(-0.75, abs=0.02), "0.2 in place of 0.8"


def test_what_an_effect_tells_replays_of_time_reaches_the_bodies_and_the_loops_phase_does_not() -> None:
    """An effect with no other equation than `replay_timing`: the bodies are run anew, and its footprint holds them."""
    late = Effect(
        "late_encoder",
        "the link's encoder is read late",
        "sensors",
        "joint",
        (Parameter("age", "s", 0.0, 0.02, 0.002),),
        {"replay_timing": lambda p, timing, _: timing._replace(link_age=timing.link_age + p.age)},
    )
    log = read_log(DATA / "air_reference_1500ms.csv.gz")
    evidence = gather(log, nominal_model(), {late.name: late}, noise_of(log))
    start = evidence.start()
    aged = start._replace(x=evidence.atoms.set(start.x, late.name, "all", {"age": 0.005}))
    rest, moved = evidence.body_residual([start, aged])
    assert np.abs(moved - rest).max() > 1.0
    every = [np.ones(evidence.blocks, bool)]
    assert noise_at(late, "all", [evidence], every) == pytest.approx(evidence.weight().sum(), rel=1e-6)
    (phase, *_) = evidence.atoms.of(LOOP_TIMING.name)
    assert not evidence.atoms.touching(FELT_BY_BODIES)[phase.start], "each step of a fit would run the bodies"
