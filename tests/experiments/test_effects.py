"""Effects: off is off to the bit, on changes what it names, places are what they say, users' files join."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.effects import LIBRARY, Effect, Parameter, load_effects
from experiments.effects.compose import activate
from experiments.effects.places import mask, places_of
from experiments.errors import UserError
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.behind_sensors import behind_sensors
from experiments.measurement.evidence.drive_evidence import FELT_BY_DRIVES
from experiments.measurement.evidence.drive_log import DriveLog
from experiments.measurement.evidence.drive_replay import DriveReplay, true_motion
from experiments.measurement.fits.fit_types import Placed
from experiments.model import FittedValue, PlacedEffect, nominal_model
from experiments.plant import make_plant
from mjx_starleth.names import JOINT_NAMES
from sea_jax import JointMotion, LoopPeriods, params_from_numbers

ROWS = 200
NAMED = """coulomb_friction viscous_friction cubic_friction stribeck_friction load_friction
direction_dependent_friction motor_inertia torque_constant torque_constant_saturation torque_ripple bus_voltage_sag
command_delay backlash spring_stiffness spring_stiffening spring_damping spring_hysteresis joint_coulomb_drag
joint_viscous_drag payload link_mass ground_friction ground_compliance ground_slope constant_force
joint_encoder_offset torque_sensor_gain torque_sensor_offset sensor_delay""".split()
ON_DRIVES = [name for name in NAMED if set(LIBRARY[name].equations) & FELT_BY_DRIVES]
ON_BODIES = [name for name in (*NAMED, "link_com") if "body_parameters" in LIBRARY[name].equations]


def test_every_effect_of_the_method_is_in_the_library() -> None:
    assert set(NAMED) <= set(LIBRARY)


@pytest.fixture(scope="module")
def replays():
    """Replay of hard-driven joints for any table of atoms: one compiled program for all effects."""
    numbers = nominal_model().numbers.model_dump(mode="json")
    atoms = Atoms(tuple(LIBRARY[name] for name in ON_DRIVES), JOINT_NAMES)
    params, replay = params_from_numbers(numbers), DriveReplay(LoopPeriods(), atoms.active())
    time = 2.5e-3 * np.arange(ROWS)[:, None]
    phase = np.linspace(0, 3, 12)[None, :]
    q, v = 0.3 * np.sin(20 * time + phase), 6.0 * np.cos(20 * time + phase)
    # beyond what the battery can give at this speed, so that even a sagging supply shows
    torque = (
        28.0 * np.sign(np.sin(35 * time + phase)) * np.where(np.arange(12) % 3 == 2, np.array([1] * 6 + [-1] * 6), 1)
    )
    zero = np.zeros_like(q)
    columns = (torque, q, zero, q, v, zero, q + 0.1, zero, zero)
    log = DriveLog(*(np.asarray(c, np.float32) for c in columns))
    motion = true_motion(log, 2.5e-3, {})
    run = jax.jit(lambda x: replay.predict(params, log, motion, atoms.numbers(x), jnp.zeros(12)))
    return atoms, lambda x: np.asarray(run(jnp.asarray(x, jnp.float32)))


@pytest.mark.parametrize("name", ON_DRIVES)
def test_an_effect_acts_where_it_is_placed_and_nowhere_else(replays, name: str) -> None:
    atoms, run = replays
    effect = LIBRARY[name]
    values = {p.name: p.start if p.start else p.high / 10 for p in effect.parameters}
    off, on = run(atoms.off()), run(atoms.set(atoms.off(), name, "RF_HFE", values))
    change = np.abs(on - off).max((0, 2))
    joint = JOINT_NAMES.index("RF_HFE")
    assert change[joint] > 1e-6, f"{name} changes nothing"
    assert (np.delete(change, joint) == 0).all()


def test_drives_whose_sensors_are_two_rows_late_show_what_they_were(replays) -> None:
    """By torque the joint controllers need no angle of the motor: nothing else changes."""
    atoms, run = replays
    late = run(atoms.set(atoms.off(), "sensor_delay", "all", {"joint_side": 0.0, "motor_side": 0.005}))
    np.testing.assert_allclose(late[2:], run(atoms.off())[:-2], rtol=1e-5, atol=1e-5)


def test_behind_the_sensors_lie_the_true_motion_and_torque() -> None:
    time, w, period = 2.5e-3 * np.arange(400)[:, None], 2 * np.pi * np.linspace(0.5, 2.0, 12)[None], 2.5e-3

    def turning(t):
        parts = (np.sin(w * t), w * np.cos(w * t), -w * w * np.sin(w * t), 0 * w * t)
        return JointMotion(*(np.asarray(part, np.float32) for part in parts))

    names = ("joint_encoder_offset", "torque_sensor_gain", "torque_sensor_offset", "sensor_delay")
    atoms = Atoms(tuple(LIBRARY[name] for name in names), JOINT_NAMES)
    x = atoms.set(atoms.off(), "joint_encoder_offset", "LF", {"offset": 0.1})
    x = atoms.set(atoms.set(x, "torque_sensor_gain", "KFE", {"relative": 0.2}), names[2], "all", {"offset": -0.5})
    x = atoms.set(x, "sensor_delay", "HFE", {"joint_side": 6e-3, "motor_side": 4e-3})
    hfe, kfe, lf = (np.array([part in name for name in JOINT_NAMES]) for part in ("HFE", "KFE", "LF"))
    logged = turning(time - 6e-3 * hfe)
    logged = logged._replace(position=logged.position + np.float32(0.1) * lf)
    torque = np.asarray(9.0 * np.cos(w * (time - 4e-3 * hfe)) * (1.0 + 0.2 * kfe) - 0.5, np.float32)
    behind = jax.jit(lambda x: behind_sensors(atoms.active(), atoms.numbers(x), logged, torque, period))
    motion, true_torque = behind(jnp.asarray(x, jnp.float32))
    for found, true, tolerance in zip(motion, turning(time), (1e-5, 5e-3, 0.05, 0.0), strict=True):
        np.testing.assert_allclose(found[5:-5], true[5:-5], atol=tolerance)
    np.testing.assert_allclose(true_torque[5:-5], (9.0 * np.cos(w * time))[5:-5], atol=2e-3)


def test_a_users_sensor_effect_may_look_at_the_links_motion_wherever_it_acts() -> None:
    """A torque sensor whose seal drags: in the plant, in the replay of the drives, and undone for the bodies."""
    seal = Effect(
        "seal",
        "the torque sensor shows the drag of its seal",
        "sensors",
        "joint",
        (Parameter("drag", "N m s/rad", 0.0, 1.0, 0.1),),
        {"measurement": lambda p, m, s: m._replace(torque=m.torque + p.drag * s.joint_velocity)},
    )
    drag, speed, torque = 0.5, np.full((8, 12), 3.0, np.float32), np.full((8, 12), 2.0, np.float32)
    active, numbers, _ = activate([Placed("seal", "all", {"drag": drag})], {"seal": seal})
    motion = JointMotion(0.0 * speed, speed, 0.0 * speed, 0.0 * speed)
    np.testing.assert_allclose(behind_sensors(active, numbers, motion, torque, 2.5e-3)[1], torque - drag * speed)

    plant = make_plant(nominal_model().with_effect(placed("seal", drag)), library=LIBRARY | {"seal": seal})
    state = plant.initial_state(plant.params, jnp.zeros(19).at[3].set(1.0), jnp.zeros(12))
    moving = state._replace(bodies=state.bodies._replace(u=state.bodies.u.at[6:].set(3.0)))
    shown = plant.measure(plant.params, moving)[1].torque - plant.measure(plant.params, state)[1].torque
    np.testing.assert_allclose(shown, drag * 3.0 * np.ones(12), rtol=1e-6)

    zero = np.zeros_like(speed)
    log = DriveLog(zero, zero, zero, zero, speed, zero, zero, zero, zero)
    params = params_from_numbers(nominal_model().numbers.model_dump(mode="json"))
    replay = DriveReplay(LoopPeriods(), active)
    sealed, bare = (
        replay.predict(params, log, motion, ({"drag": jnp.full(12, size)},), jnp.zeros(12))[..., 1]
        for size in (drag, 0.0)
    )
    np.testing.assert_allclose(sealed - bare, drag * speed, rtol=1e-4)


def placed(effect: str, drag: float) -> PlacedEffect:
    return PlacedEffect(effect=effect, where="all", parameters={"drag": FittedValue(value=drag)})


def test_an_effect_at_zero_is_left_out_of_the_program() -> None:
    off = [
        Placed(name, places_of(LIBRARY[name].axis)[0], {p.name: p.off for p in LIBRARY[name].parameters})
        for name in NAMED
    ]
    effects, numbers, placements = activate(off, LIBRARY)
    assert effects.effects == () and numbers == () and placements == ()


def test_where_two_of_an_effect_overlap_the_last_rules_in_the_plant_as_in_the_replay() -> None:
    placed = [
        Placed("coulomb_friction", "all", {"torque": 0.01}),
        Placed("coulomb_friction", "LH", {"torque": 0.0}),
        Placed("coulomb_friction", "LH_KFE", {"torque": 0.03}),
    ]
    active, numbers, placements = activate(placed, LIBRARY)
    expected = np.full(12, 0.01)
    expected[6:8], expected[8] = 0.0, 0.03
    assert [effect.name for effect in active.effects] == ["coulomb_friction"]
    np.testing.assert_allclose(numbers[0]["torque"], expected, rtol=1e-6)
    atoms = Atoms(active.effects, JOINT_NAMES)
    np.testing.assert_allclose(atoms.placed(atoms.off(), placed), expected)
    assert [one.here.sum() for one in placements] == [9, 2, 1]


@pytest.mark.parametrize("name", ON_BODIES)
def test_effects_on_bodies_change_the_numbers_they_name(name: str) -> None:
    plant = make_plant(nominal_model())
    effect = LIBRARY[name]
    where = places_of(effect.axis)[0]
    values = {p.name: p.start if p.start else p.high / 10 for p in effect.parameters}
    active, numbers, _ = activate([Placed(name, where, values)], LIBRARY)
    changed = active.apply("body_parameters", numbers, plant.params.bodies)
    leaves = zip(jax.tree.leaves(plant.params.bodies), jax.tree.leaves(changed), strict=True)
    assert any(np.abs(np.asarray(b) - np.asarray(a)).max(initial=0) > 0 for a, b in leaves)


def test_payload_is_the_parallel_axis_theorem() -> None:
    plant = make_plant(nominal_model())
    place = np.array([0.1, -0.05, 0.2])
    active, numbers, _ = activate([Placed("payload", "torso", {"mass": 4.0, "x": 0.1, "y": -0.05, "z": 0.2})], LIBRARY)
    b = active.apply("body_parameters", numbers, plant.params.bodies)
    torso = float(plant.params.bodies.mass[0])
    com = 4.0 * place / (torso + 4.0)
    inertia = np.diag(np.asarray(plant.params.bodies.inertia[0], float))
    for mass, r in ((torso, -com), (4.0, place - com)):
        inertia = inertia + mass * (r @ r * np.eye(3) - np.outer(r, r))
    np.testing.assert_allclose(b.com[0], com, rtol=1e-5)
    np.testing.assert_allclose(b.inertia[0], np.diag(inertia), rtol=1e-5)


def test_within_the_play_nothing_touches_not_even_the_damper() -> None:
    equations = LIBRARY["backlash"].equations
    p = SimpleNamespace(half_width=jnp.asarray([0.02, 0.02, 0.0]))
    deflection = equations["deflection"](p, jnp.asarray([0.01, 0.05, 0.0]), None)
    np.testing.assert_allclose(deflection, [0.0, 0.03, 0.0], atol=1e-7)
    torque = equations["spring"](p, jnp.ones(3), SimpleNamespace(deflection=deflection))
    assert torque.tolist() == [0.0, 1.0, 1.0]  # without play a deflection of zero is no gap


def test_motors_that_brake_feed_the_others_and_not_the_supply() -> None:
    sag = LIBRARY["bus_voltage_sag"].equations["supply_voltage"]
    p = SimpleNamespace(resistance=jnp.full(2, 1.0), switching=jnp.ones(2))
    volts = jnp.full(2, 48.0)

    def left(powers):
        currents = jnp.asarray(powers, jnp.float32) / 10.0
        return float(sag(p, volts, SimpleNamespace(winding_voltage=jnp.full(2, 10.0), current=currents))[0])

    # V = V_0 - R P / V at the supply: 48 V at 1 ohm
    assert left([150.0, -50.0]) == pytest.approx(24.0 + np.sqrt(24.0**2 - 100.0), rel=1e-5)
    assert left([50.0, -150.0]) == 48.0


def test_places() -> None:
    assert mask("KFE", "joint").tolist() == [0, 0, 1] * 4
    assert mask("LH", "link").tolist() == [0] * 6 + [1] * 3 + [0] * 3
    assert mask("feet", "foot").sum() == 4
    assert mask("feet", "ground").tolist() == [1] and places_of("ground") == ("feet",)
    with pytest.raises(ValueError, match="no place 'tail'"):
        mask("tail", "joint")


def test_a_users_file_joins_the_library(tmp_path) -> None:
    good = tmp_path / "cogging.py"
    good.write_text(
        "import jax.numpy as jnp\n"
        "from experiments.effects import Effect, Parameter\n"
        "EFFECT = Effect('cogging', 'magnets', 'drive', 'joint', (Parameter('torque', 'N m', 0, 1, 0.1),),\n"
        "    {'motor_torque': lambda p, torque, s: torque + p.torque * jnp.sin(400 * s.motor_position)})\n"
    )
    assert "cogging" in load_effects([good])
    bad = tmp_path / "bad.py"
    bad.write_text("EFFECT = 3\n")
    for path, words in ((bad, "must bind EFFECT"), (tmp_path / "none.py", "No effect file")):
        with pytest.raises(UserError, match=words):
            load_effects([path])
