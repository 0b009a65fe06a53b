"""The independent plant: closed forms, SciPy, a recorded log of another simulator, and every effect one by one."""

import gzip
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from experiments.errors import UserError
from experiments.independent_plant import leg_geometry
from experiments.independent_plant.bench_bodies import BenchBodies, Load, nominal_load
from experiments.independent_plant.bodies import Bodies, BodyChanges, model_text
from experiments.independent_plant.cases import benchmark
from experiments.independent_plant.drive import STEP, Command, Drive, JointController, Measured
from experiments.independent_plant.generate import generate
from experiments.independent_plant.hooks import hooked
from experiments.independent_plant.library import FAMILIES, LIBRARY, OUTSIDERS, Effect, families_of
from experiments.independent_plant.log_setup import LogSetup, hanging, standing
from experiments.independent_plant.numbers import JOINT_NAMES, BodyNumbers, joints_at, nominal_drive
from experiments.independent_plant.plant import PERIOD, Plant, Recording, simulate
from experiments.independent_plant.play import Targets, play_command, replay_jump
from experiments.independent_plant.runner import Case, record
from experiments.independent_plant.sensors import NOISE_STD, SensorSettings
from experiments.independent_plant.stance import STAND, GroundController, squat_course
from experiments.independent_plant.strength import parameter_for, strength
from experiments.measurement.logs.log_reader import read_log

DATA = Path(__file__).parents[1] / "data"
PERFECT = SensorSettings(noise=0.0, quantised=False)
AIR_SIGNALS = (
    "joint_position",
    "joint_velocity",
    "motor_position",
    "motor_velocity",
    "joint_torque",
    "motor_current",
)
GROUND_SIGNALS = (
    "base_position",
    "base_orientation",
    "base_linear_velocity",
    "base_angular_velocity",
    "base_acceleration",
    "foot_contact",
)
WEIGHT = leg_geometry.TOTAL_MASS * leg_geometry.GRAVITY


# --- closed forms ------------------------------------------------------------------------------------------------


def test_a_bench_pendulum_swings_with_the_period_of_the_closed_form():
    bodies = BenchBodies([Load(0.1, 0.0, 2.0)], [BodyChanges()])
    bodies.place(np.full((1, 12), 0.05), np.zeros((1, 3)), np.zeros((1, 4)))
    period = 2 * np.pi * np.sqrt(0.1 / 2.0) * (1 + 0.05**2 / 16)
    angles = []
    for _ in range(round(period / STEP)):
        bodies.step(np.zeros((1, 12)))
        angles.append(bodies.position[0, 0])
    # explicit in the torque: the amplitude grows by h w^2 T/2, 0.2 % at this step
    assert angles[-1] == pytest.approx(0.05, rel=5e-3)
    assert min(angles) == pytest.approx(-0.05, rel=5e-3)


def test_legs_swinging_freely_keep_their_energy():
    text = model_text("fixed_base", BodyNumbers(), BodyChanges(end_stops=False))
    bodies = Bodies([text])
    model, data = bodies.models[0], bodies.datas[0]
    bodies.place(np.tile([0.2, 0.4, -0.6], 4)[None], np.zeros((1, 3)), np.zeros((1, 4)))

    def energy() -> tuple[float, float]:
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        return float(data.energy[0]), float(data.energy[1])

    first, swing = sum(energy()), 0.0
    for _ in range(3000):
        bodies.step(np.zeros((1, 12)))
        swing = max(swing, float(np.abs(bodies.velocity).max()))
    potential, kinetic = energy()
    assert swing > 1.0
    # semi-implicit Euler at 0.1 ms: the error stays of the order of the step, 0.1 % of what swings
    assert potential + kinetic == pytest.approx(first, abs=1e-3 * max(kinetic, 1.0))


def held_drive(amperes: float, coulomb: float) -> Drive:
    """A drive with its current loop held at a current, its joint held, no spring."""
    numbers = nominal_drive(1)
    numbers.friction_coulomb = np.full((1, 12), coulomb)
    numbers.spring_stiffness = numbers.stop_stiffness = np.zeros((1, 12))
    numbers.spring_damping = numbers.stop_damping = np.zeros((1, 12))
    drive = Drive(numbers)
    drive.current = np.full((1, 12), amperes)
    drive.control_currents = lambda: setattr(drive, "voltage", numbers.resistance * amperes)
    return drive


def test_a_motor_sticks_exactly_below_the_coulomb_level_and_breaks_away_above():
    still = np.zeros((1, 12))
    below, above = held_drive(0.42, 0.012), held_drive(0.45, 0.012)  # 0.0116 and 0.0124 N m at the rotor
    for _ in range(500):
        below.step(still, still)
        above.step(still, still)
    assert np.all(below.motor_velocity == 0.0) and np.all(below.motor_position == 0.0)
    assert np.all(above.motor_velocity > 1e-3)


def test_a_coasting_motor_stops_where_the_closed_form_says_and_rests():
    numbers = nominal_drive(1)
    drive = held_drive(0.0, 0.012)
    drive.numbers.friction_viscous = drive.numbers.back_emf_constant = np.zeros((1, 12))
    drive.motor_velocity = np.full((1, 12), 3.0)
    still = np.zeros((1, 12))
    for _ in range(3000):
        drive.step(still, still)
    deceleration = 0.012 / (numbers.motor_inertia * 100.0)
    # the event falls inside a step and is placed there, so only round-off is left
    np.testing.assert_allclose(drive.motor_position, 3.0**2 / (2 * deceleration), rtol=1e-9)
    assert np.all(drive.motor_velocity == 0.0)


def test_the_drive_keeps_its_current_voltage_speed_and_power_limits():
    drive = Drive(nominal_drive(1))
    still = np.zeros((1, 12))
    drive.wanted_velocity = np.full((1, 12), 10.0)
    currents, voltages = [], []
    for _ in range(400):
        drive.step(still, still)
        currents.append(drive.wanted_current.max())
        voltages.append(np.abs(drive.voltage).max())
    assert max(currents) == pytest.approx(9.4)
    assert max(voltages) <= 48.0
    rest = {name: np.zeros((1, 12)) for name in ("position", "velocity", "motor_position")}
    far = Command(np.full((1, 12), np.nan), np.full((1, 12), 2.0))
    assert np.all(JointController()(far, Measured(torque=np.zeros((1, 12)), **rest)) == 10.0)
    loaded = JointController()(far, Measured(torque=np.full((1, 12), -36.0), **rest))
    np.testing.assert_allclose(loaded, 180.0 / 36.0)


def test_step_response_agrees_with_scipy():
    """Joint held, velocity step of 2 rad/s: discrete loops around continuous electronics and mechanics."""
    drive = Drive(nominal_drive(1))
    still, j = np.zeros((1, 12)), 0  # HAA: two-sided spring
    drive.wanted_velocity = np.full((1, 12), 2.0)
    K, R, L, J, N, c0, c1, k, d = 0.0276, 0.386, 65.3e-6, 6.6e-6, 100, 0.012, 2.5e-5, 70.0, 0.3

    def rates(_, x, voltage):
        current, speed, angle = x  # speed and angle at the rotor
        spring = k * angle / N + d * speed / N
        return [
            (voltage - R * current - K * speed) / L,
            (K * current - min(c0, K * current) * (speed <= 0.0) - c0 * (speed > 0.0) - c1 * speed - spring / N) / J,
            speed,
        ]

    x, integral, voltage_integral, wanted = np.zeros(3), 0.0, 0.0, 0.0
    ours, theirs = [], []
    for step in range(150):
        drive.step(still, still)
        if step % 5 == 0:
            error = N * 2.0 - x[1]
            integral = np.clip(integral + 14.0 * 5e-4 * error, -9.4, 9.4)
            wanted = np.clip(0.14 * error + integral, -9.4, 9.4)
        voltage_integral = np.clip(voltage_integral + 2400.0 * 1e-4 * (wanted - x[0]), -48.0, 48.0)
        voltage = np.clip(0.40 * (wanted - x[0]) + voltage_integral, -48.0, 48.0)
        x = solve_ivp(rates, (0, STEP), x, args=(voltage,), rtol=1e-9, atol=1e-12).y[:, -1]
        ours.append([drive.current[0, j], drive.motor_velocity[0, j], drive.motor_position[0, j]])
        theirs.append([x[0], x[1] / N, x[2] / N])
    ours, theirs = np.array(ours), np.array(theirs)
    # the electronics see the speed of the step's beginning: an error of the order of the step
    for column, scale in enumerate((9.4, 2.0, 0.02)):
        assert np.abs(ours - theirs)[:, column].max() < 0.01 * scale
    assert theirs[-1, 1] > 1.0


# --- whole robot -------------------------------------------------------------------------------------------------


def test_feet_carry_the_weight_and_payload_and_soft_ground_do_what_they_say():
    payload = Effect("payload", "torso", {"mass": 3.0, "z": 0.1})
    soft = Effect("ground_compliance", "feet", {"compliance": 1e-4, "damping": 100.0})
    setups = [LogSetup(0, effects, sensors=PERFECT) for effects in ((), (payload,), (soft,))]
    plant = Plant("ground", setups, standing(setups, STAND), 400)
    controller = GroundController([squat_course(0.6, "poor", np.random.default_rng(0)) for _ in setups])
    forces = []
    for _ in range(plant.rows):
        row = plant.measure()
        plant.tick(row, controller(0, row))
        forces.append(plant.now["foot_force"].sum(axis=1))
    # a second after the start the torso still creeps: 2 % of the weight
    np.testing.assert_allclose(np.mean(forces[-100:], axis=0), [WEIGHT, WEIGHT + 3.0 * 9.81, WEIGHT], rtol=0.02)
    heights = [data.geom(leg).xpos[2] for data in plant.bodies.datas for leg in ("LF", "RF", "LH", "RH")]
    sunk = leg_geometry.FOOT_RADIUS - np.reshape(heights, (3, 4)).mean(axis=1)
    assert abs(sunk[0]) < 1e-4  # the hard ground
    assert sunk[2] - sunk[0] == pytest.approx(1e-4 * WEIGHT / 4, rel=0.05)


def recorded(name: str, rows: int) -> dict[str, np.ndarray]:
    """Signals of a log that another simulator made of the same nominal robot, (T, n)."""
    with gzip.open(DATA / f"{name}.csv.gz", "rt") as file:
        names = file.readline().strip().split(",")
        table = np.genfromtxt(file, delimiter=",", max_rows=rows)
    signals: dict[str, list[np.ndarray]] = {}
    for column, values in zip(names, table.T):
        signals.setdefault(column.split("/")[0], []).append(values)
    return {signal: np.stack(columns, axis=1) for signal, columns in signals.items()}


def misfits(recording: Recording, log: dict[str, np.ndarray]) -> dict[str, float]:
    """The worst channel's RMS misfit of each signal, in standard deviations of its noise."""
    return {
        signal: float(np.sqrt(np.mean(np.square(values[0] - log[signal]), axis=0)).max() / NOISE_STD[signal])
        for signal, values in recording.true.items()
        if signal in log
    }


def test_it_replays_a_log_of_another_simulator_with_its_legs_in_the_air():
    """The same commands for 0.5 s, nothing fed back from the log."""
    log = recorded("air_reference_1500ms", 200)
    wanted, none = log["command_position"], np.full((1, 12), np.nan)
    recording = simulate(
        "fixed_base",
        [LogSetup(0, sensors=PERFECT, end_stops=False)],
        lambda k, row: Command(none, wanted[k][None]),
        hanging(wanted[:1]),
        len(wanted) * PERIOD,
    )
    # The log's loops saw the noise of their sensors and this run's do not: that moves its motors by a few of theirs.
    most = {
        "motor_position": 8.0,
        "motor_current": 2.5,
        "joint_torque": 2.5,
        "joint_position": 4.0,
        "joint_velocity": 1.5,
    }
    found = misfits(recording, log)
    assert set(found) == set(most)
    for signal, misfit in found.items():
        assert misfit < most[signal], signal


def test_it_replays_a_squat_of_another_simulator_on_the_ground():
    """The same commands for 0.3 s, the joint controllers seeing what the log's saw: the torso to the noise."""
    log = recorded("squat_with_torso_300ms", 120)
    setups = [LogSetup(0, sensors=PERFECT, end_stops=False)]
    plant = Plant("ground", setups, standing(setups, 0.4), len(log["time"]))
    true = []
    for k in range(plant.rows):
        plant.measure()
        true.append(plant.now)
        row = {signal: values[k][None] for signal, values in log.items()}
        plant.tick(row, Command(log["command_torque"][k][None], np.full((1, 12), np.nan)))
    for signal in ("base_position", "base_orientation", "base_linear_velocity", "base_angular_velocity"):
        error = np.array([row[signal][0] for row in true]) - log[signal]
        # 1 is noise alone; 0.3 is the spread of an RMS of 120 samples over 13 channels, and what is left
        assert np.sqrt(np.mean(np.square(error), axis=0)).max() < 1.3 * NOISE_STD[signal], signal


def test_hops_leave_the_ground_and_land_on_their_feet():
    recording = record([Case("hops", seed=1, duration=2.0)])
    contact = recording.signals["foot_contact"][0].sum(axis=1)
    assert (contact == 0).sum() > 20  # 50 ms
    assert (contact[-20:] == 4).all()
    assert recording.true["base_position"][0, :, 2].max() > 0.46
    assert not recording.fallen[0]
    # both modes, never both at once nor neither
    assert np.all(np.isnan(recording.command.torque) != np.isnan(recording.command.position))


# --- effects -----------------------------------------------------------------------------------------------------

STRONG = {"bus_voltage_sag": 20.0, "ground_friction": -0.7, "drive_dropout": 20.0, "ground_compliance": 1e-4}


def strong(name: str) -> dict[str, float]:
    """The size of an effect that is seen within a quarter of a second."""
    family = FAMILIES[name]
    if name in STRONG:
        return {family.scaled: STRONG[name]}
    motion = "air" if "joints" in family.places else "squat"
    return {family.scaled: parameter_for(motion, name, "all", 0.3)}


def assert_effects(motion: str, names: list[str], duration: float) -> None:
    """Every effect changes the log, and at strength zero none of its bits."""
    cases = [Case(motion, "rich", seed=3, duration=duration)]
    for name in names:
        family = FAMILIES[name]
        where = "all" if "joints" in family.places else family.places[0]
        cases += [
            Case(motion, "rich", (Effect(name, where, values),), 3, duration)
            for values in (strong(name), {family.scaled: 0.0})
        ]
    recording = record(cases)
    for i, name in enumerate(names):
        loud = [not np.array_equal(values[0], values[2 * i + 1]) for values in recording.signals.values()]
        quiet = [np.array_equal(values[0], values[2 * i + 2]) for values in recording.signals.values()]
        assert any(loud), f"{name} changes nothing"
        assert all(quiet), f"{name} of strength zero changes something"


def test_every_joint_effect_changes_the_log_and_none_does_at_strength_zero():
    names = [name for name, family in FAMILIES.items() if "joints" in family.places and name != "bus_voltage_sag"]
    assert_effects("air", names, 0.3)


def test_every_effect_on_torso_ground_and_supply_changes_the_log_and_none_does_at_strength_zero():
    names = [name for name, family in FAMILIES.items() if "joints" not in family.places]
    assert_effects("squat", [*names, "bus_voltage_sag"], 0.15)


def test_an_effect_acts_where_it_is_put():
    for where, joints in (("LH_KFE", [8]), ("HFE", [1, 4, 7, 10]), ("RF", [3, 4, 5]), ("all", range(12))):
        assert np.flatnonzero(joints_at(where)).tolist() == list(joints)
    quiet, put = Case("air", seed=2, duration=0.4), Effect("torque_sensor_offset", "LH_KFE", {"offset": 0.5})
    recording = record([quiet, replace(quiet, effects=(put,))])
    change = np.abs(np.diff(recording.signals["joint_torque"], axis=0)[0, 0])
    assert np.flatnonzero(change > 0.1).tolist() == [8]


def test_a_late_encoder_with_a_wrong_zero_shows_both():
    offset, late = Effect("joint_encoder_offset", "all", {"offset": 0.1}), Effect("sensor_delay", "RH", {"delay": 1e-3})
    families = families_of([[offset, late]], [np.random.default_rng(0)])
    signals = {name: np.zeros((1, 12)) for name in ("joint_position", "joint_velocity", "joint_torque")}
    for tick in range(20):
        signals["joint_position"] = np.full((1, 12), float(tick))
        for family in hooked(families, "remember"):
            family.remember(tick * STEP, signals)
    for family in hooked(families, "measure"):
        signals = family.measure(19 * STEP, signals)
    np.testing.assert_allclose(signals["joint_position"][0], [19.1] * 9 + [9.1] * 3)


def test_play_is_transmitted_only_beyond_its_half_width():
    numbers = nominal_drive(1)
    family = FAMILIES["backlash"](1)
    family.add(0, "HAA", {"half_width": 0.01}, np.random.default_rng(0))
    drive = Drive(numbers, [family])
    deflection = np.tile([0.004, 0.1, 0.1], 4)[None]
    torque = drive.spring(deflection, np.ones((1, 12)))
    assert np.all(torque[0, ::3] == 0.0)
    np.testing.assert_allclose(drive.spring(np.full((1, 12), 0.03), np.zeros((1, 12)))[0, 0], 70.0 * 0.02)


def test_hysteresis_takes_the_closed_forms_work_per_cycle():
    family = FAMILIES["spring_hysteresis"](1)
    family.add(0, "all", {"level": 0.5, "width": 1e-4}, np.random.default_rng(0))
    drive = Drive(nominal_drive(1), [family])
    phase = np.linspace(0.0, 4 * np.pi, 4001)
    angles, torques = 0.05 * np.sin(phase), []
    for angle in angles:
        torques.append(drive.spring(np.full((1, 12), angle), np.zeros((1, 12)))[0, 0])
        family.commit(drive)
    work = np.trapezoid(torques[2000:], angles[2000:])
    # a bristle far stiffer than the spring is Coulomb friction: 4 x level x amplitude per cycle
    assert work == pytest.approx(4 * 0.5 * 0.05, rel=0.02)


def test_strength_is_the_ratio_of_torques():
    size = {"change": 0.2}
    cases = [Case("air", effects=(Effect("torque_constant", "HFE", size),), seed=5, duration=0.5, sensors=PERFECT)]
    recording = record(cases)
    # all torque that the motor makes is 1 / 1.2 commanded, and the effect adds a fifth of it
    assert strength(cases[0].effects[0], recording, 0) == pytest.approx(0.2, rel=0.05)
    weak, twice = (parameter_for("air", "coulomb_friction", "HFE", level) for level in (0.05, 0.1))
    assert twice == pytest.approx(2 * weak, rel=0.25)


def test_names_places_and_parameters_that_do_not_exist_are_refused():
    with pytest.raises(ValueError, match="no effect 'blacklash'"):
        _ = Effect("blacklash").family
    with pytest.raises(ValueError, match="no joint at 'tail'"):
        record([Case("air", effects=(Effect("backlash", "tail"),), duration=0.1)])
    with pytest.raises(ValueError, match="no parameter"):
        record([Case("air", effects=(Effect("backlash", "all", {"width": 0.1}),), duration=0.1)])
    with pytest.raises(ValueError, match="acts on torso"):
        record([Case("squat", effects=(Effect("payload", "all", {"mass": 1.0}),), duration=0.1)])


# --- logs and cases ----------------------------------------------------------------------------------------------


def test_the_list_of_cases_is_seeded_and_covers_every_effect():
    cases = benchmark(3, 300)
    assert [repr(case) for case in cases] == [repr(case) for case in benchmark(3, 300)]
    assert [repr(case) for case in cases] != [repr(case) for case in benchmark(4, 300)]
    named = {effect.effect for case in cases for effect in case.effects}
    assert named == {*LIBRARY, *OUTSIDERS} and len(OUTSIDERS) >= 6
    groups = [case.group for case in cases]
    assert all(groups.count(group) >= 15 for group in ("none", "single", "pair", "outsider", "poor"))
    assert all(len({effect.effect for effect in case.effects}) == 2 for case in cases if case.group == "pair")
    for case in cases:
        factors = [factor for values in case.off.values() for factor in values]
        assert all(0.9 <= factor <= 1.1 for factor in factors)


def test_logs_are_in_the_format_the_same_for_the_same_seed_and_keep_their_truth_elsewhere(tmp_path):
    hidden = (Effect("backlash", "LH_KFE", {"half_width": 0.02}),)
    cases = [
        Case("air", seed=1, duration=0.2, effects=hidden, sensors=SensorSettings(jitter=5e-6), velocity_phase=2),
        Case("hops", seed=2, duration=0.2, group="none"),
        Case("bench_KFE", seed=3, duration=0.2, effects=(Effect("coulomb_friction", "all", {"level": 0.01}),)),
        Case("bench_rigid", seed=4, duration=0.2),
    ]
    truth = generate(cases, tmp_path / "a", tmp_path / "truth.json", workers=1)
    generate([replace(cases[0], seed=9), *cases[:2]], tmp_path / "b", tmp_path / "truth_b.json", workers=1)
    assert json.loads((tmp_path / "truth.json").read_text())["cases"] == truth
    assert truth["case_0001"]["effects"][0]["parameters"] == {"half_width": {"value": 0.02, "unit": "rad"}}
    assert truth["case_0001"]["effects"][0]["strength"] > 0.0 and truth["case_0002"]["effects"] == []

    air = read_log(tmp_path / "a/case_0001.csv.gz")
    assert (air.robot, air.experiment, air.sample_period) == ("starleth", "fixed_base", 2.5e-3)
    assert set(air.signals) == {"command_torque", "command_position", *AIR_SIGNALS}
    assert np.isnan(air.signals["command_torque"].values).all() and air.time.shape == (80,)
    ground = read_log(tmp_path / "a/case_0002.csv.gz")
    assert set(ground.signals) == {*air.signals, *GROUND_SIGNALS} and ground.experiment == "ground"
    assert not ground.unread and set(ground.noise_std) == {*AIR_SIGNALS, *GROUND_SIGNALS} - {"foot_contact"}
    elastic, rigid = (read_log(tmp_path / f"a/case_000{i}.csv.gz") for i in (3, 4))
    assert elastic.robot == rigid.robot == "joint" and elastic.joint.inertia == nominal_load("KFE").inertia
    assert set(elastic.signals) == {"command_position", *AIR_SIGNALS}
    assert set(rigid.signals) == {"command_position", "joint_position", "applied_torque"}
    assert rigid.time.shape == (200,)

    def content(folder: str, number: int) -> bytes:
        return (tmp_path / folder / f"case_000{number}.csv.gz").read_bytes()

    # the same case alone, or beside others, or at another place in the list: the same bytes
    assert content("a", 1) == content("b", 2) and content("a", 2) == content("b", 3)
    assert content("b", 1) != content("b", 2)
    hints = [path.read_text() for path in (tmp_path / "a").glob("*.json")]
    assert not any("backlash" in text or "seed" in text for text in hints)
    with pytest.raises(UserError, match="truth must not lie"):
        generate(cases[:1], tmp_path / "c", tmp_path / "c/truth.json", workers=1)


def test_the_noise_is_what_the_log_says():
    recording = record([Case("air", "poor", seed=1, duration=0.5)])
    for signal in ("joint_position", "motor_position", "joint_torque", "motor_current"):
        error = recording.signals[signal] - recording.true[signal]
        assert error.std() == pytest.approx(NOISE_STD[signal], rel=0.06), signal
        assert abs(error.mean()) < 0.1 * NOISE_STD[signal]


def test_a_command_file_is_played_and_a_bad_one_refused(tmp_path):
    joints = ",".join(f"command_position/{joint}" for joint in JOINT_NAMES)
    stance = leg_geometry.stance_angles(0.42)
    rows = [",".join(map(str, [time, *(stance + 0.1 * np.sin(8 * time))])) for time in (0.0, 0.05, 0.1, 0.15)]
    (tmp_path / "next.csv").write_text("\n".join([f"time,{joints}", *rows]) + "\n")
    recording = play_command(
        tmp_path / "next.csv", tmp_path / "played", (Effect("backlash", "KFE", {"half_width": 0.01}),)
    )
    assert recording.command.position.shape == (1, 61, 12)
    np.testing.assert_allclose(recording.command.position[0, [19, 20, 40], 0], 0.1 * np.sin([0.0, 0.4, 0.8]))
    log = read_log(tmp_path / "played.csv.gz")
    assert log.time.shape == (61,) and np.abs(log.signals["joint_velocity"].values).max() > 0.3
    for text, complaint in (("", "cannot be read|no command table"), ("time\n0\n1\n", "commands no joint")):
        (tmp_path / "bad.csv").write_text(text)
        with pytest.raises(UserError, match=complaint):
            play_command(tmp_path / "bad.csv", tmp_path / "out")


def test_a_controller_can_drive_the_robot_on_the_ground():
    stance = leg_geometry.stance_angles(0.42)
    load = standing([LogSetup(0)], 0.42).spring_torque[0]
    seen = []

    def hold(state, tick):
        seen.append(state)
        torque = load + 40.0 * (stance - state.q) - 1.0 * state.qd
        return Targets(torque, np.zeros(12), np.zeros(12))

    jump = replay_jump(hold, 0.3, height=0.42)
    assert [tick for tick, _ in enumerate(seen)] == list(range(120))
    assert seen[0].R_WB == pytest.approx(np.eye(3)) and seen[-1].contact.tolist() == [1.0] * 4
    assert jump.apex_height == pytest.approx(0.42, abs=0.01) and jump.flight_time < 0.01
    assert not jump.fallen
    dropped = replay_jump(lambda state, tick: Targets(np.zeros(12), np.zeros(12), np.zeros(12)), 0.3, height=0.42)
    assert dropped.true["base_position"][-1, 2] < 0.38


def test_it_imports_nothing_of_the_model():
    program = (
        "import sys, experiments.independent_plant.generate, experiments.independent_plant.play;"
        "print([m for m in sys.modules if m.split('.')[0] in"
        " ('jax', 'sea_jax', 'controller_jax', 'es', 'mjx_starleth') or m.startswith(('experiments.measurement',"
        " 'experiments.effects', 'experiments.plant', 'experiments.model'))])"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.parametrize("kept", range(4))
def test_killed_between_its_files_a_job_leaves_whole_ones_and_no_table_without_its_json(tmp_path, monkeypatch, kept):
    """Killed before the (kept + 1)-th file takes its name: of two logs and their truth, what is there is whole."""
    cases = [Case("bench_rigid", seed=4, duration=0.1), Case("bench_rigid", seed=5, duration=0.1)]
    done, rename = [], os.replace

    def killed(source, target):
        if len(done) == kept:
            raise KeyboardInterrupt
        done.append(Path(target).name)
        rename(source, target)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(os, "replace", killed)
        generate(cases, tmp_path / "logs", tmp_path / "truth.json", workers=1)
    there = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert there == set(done) and "truth.json" not in there
    tables = list((tmp_path / "logs").glob("*.csv.gz"))
    assert [read_log(path).rows for path in tables] == [100] * len(tables) == [100] * (kept // 2)
    assert len(generate(cases, tmp_path / "logs", tmp_path / "truth.json", workers=1)) == 2
