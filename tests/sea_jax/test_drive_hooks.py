"""Hooks: each point changes the drive as an equation spliced in there must, and none costs or changes nothing."""

import jax.numpy as jnp
import numpy as np
import pytest
from drive_scenarios import PARAMS, Scenario, chirp, play, sway

from sea_jax import DriveHooks, JointCommand, JointMeasurement, JointMotion, full_drive, initial_state

T = 60
SCENARIO = Scenario("LF_HFE", torque=chirp(T, 8, 2, 8), link=sway(T, 0.2, 5))
POINTS = DriveHooks._fields
CHANNELS = ("theta", "w", "I", "torque")

# Changing a parameter and scaling the value at its hook are the same equation, rounded in another order.
SAME = 2e-4


def unchanged(value, signals, memory):
    return value, memory


def close(found, expected):
    for name in CHANNELS:
        scale = np.abs(expected[name]).max()
        np.testing.assert_allclose(found[name], expected[name], rtol=0, atol=SAME * scale, err_msg=name)


@pytest.mark.parametrize("drive", ["full", "cheap"])
def test_hooks_that_change_nothing_change_no_bit(drive):
    plain, hooked = play(SCENARIO, drive), play(SCENARIO, drive, hooks=DriveHooks(*((unchanged,),) * len(POINTS)))
    for name in CHANNELS:
        np.testing.assert_array_equal(plain[name], hooked[name])


@pytest.mark.parametrize(
    ("hooks", "changes"),
    [
        (DriveHooks(supply_voltage=(lambda v, s, m: (v - 30.0, m),)), {"bus": 18.0}),
        (DriveHooks(friction=(lambda f, s, m: (f._replace(coulomb=f.coulomb + 0.05), m),)), {"c0": 0.062}),
        (
            DriveHooks(friction=(lambda f, s, m: (f._replace(smooth=f.smooth + 2e-4 * 100 * s.motor_velocity), m),)),
            {"c1": 2.25e-4},
        ),
        (DriveHooks(spring=(lambda t, s, m: (t + 30.0 * s.deflection, m),)), {"k": 100.0}),
        (DriveHooks(spring=(lambda t, s, m: (t + 0.2 * s.deflection_rate, m),)), {"d": 0.5}),
        (DriveHooks(motor_torque=(lambda t, s, m: (1.2 * t, m),)), {"K": 1.2 * 0.0276}),
        (DriveHooks(motor_torque=(lambda t, s, m: (t + 0.2 * 0.0276 * s.current, m),)), {"K": 1.2 * 0.0276}),
    ],
    ids=["supply", "coulomb", "viscous", "stiffness", "damping", "torque constant", "current"],
)
def test_a_hook_can_do_what_a_parameter_does(hooks, changes):
    changed = play(Scenario(SCENARIO.joint, torque=SCENARIO.torque, link=SCENARIO.link, changes=changes))
    close(play(SCENARIO, hooks=hooks), changed)
    assert np.abs(changed["theta"] - play(SCENARIO)["theta"]).max() > 1e-4  # the change is felt


def test_hooks_act_in_order():
    double, add = (lambda v, s, m: (2.0 * v, m)), (lambda v, s, m: (v + 0.1, m))
    first = play(SCENARIO, hooks=DriveHooks(deflection=(double, add)))
    both = play(SCENARIO, hooks=DriveHooks(deflection=(lambda v, s, m: (2.0 * v + 0.1, m),)))
    other = play(SCENARIO, hooks=DriveHooks(deflection=(add, double)))
    close(first, both)
    assert np.abs(first["torque"] - other["torque"]).max() > 0.1


def test_memory_delays_a_command_by_whole_periods():
    def late(command, signals, memory):
        return memory[0], (memory[1], command)

    zero = jnp.zeros(1, jnp.float32)
    silent = JointCommand(zero, zero, zero)
    delayed = play(
        Scenario("LF_HFE", torque=SCENARIO.torque),
        hooks=DriveHooks(command=(late,)),
        memory={"command": ((silent, silent),)},
    )
    prompt = play(Scenario("LF_HFE", torque=np.append([0.0, 0.0], SCENARIO.torque[:-2])))
    for name in CHANNELS:
        np.testing.assert_array_equal(delayed[name], prompt[name])


def test_measurement_hook_falsifies_what_the_joint_controllers_see():
    wrong = DriveHooks(measurement=(lambda x, s, m: (x._replace(torque=x.torque + 1.5), m),))
    steady = Scenario("LF_HAA", torque=np.full(200, 5.0))
    assert play(steady)["torque"][-1] == pytest.approx(5.0, abs=0.02)
    assert play(steady, hooks=wrong)["torque"][-1] == pytest.approx(3.5, abs=0.02)


def test_backlash_leaves_no_torque_within_the_gap():
    width = 0.02

    def gap(deflection, signals, memory):
        return deflection - jnp.clip(deflection, -width, width), memory

    def loose(torque, signals, memory):
        return jnp.where(signals.deflection == 0.0, 0.0, torque), memory

    found = play(SCENARIO, hooks=DriveHooks(deflection=(gap,), spring=(loose,)))
    play_angle = np.abs(found["theta"] - SCENARIO.motion()[:, 0])
    inside = play_angle < 0.99 * width
    assert inside.sum() > 3
    assert np.all(found["torque"][inside] == 0.0)
    assert np.all(found["torque"][play_angle > 1.01 * width] != 0.0)


def test_memory_of_a_spring_hook_advances_once_a_step():
    def count(torque, signals, steps):
        return torque, steps + signals.period

    zero = jnp.zeros(12)
    state = initial_state(PARAMS, zero, zero, memory={"spring": (jnp.zeros(12), None)})
    inputs = (
        JointCommand(zero, zero, zero),
        JointMeasurement(zero, zero, zero, zero),
        JointMotion(zero, zero, zero, zero),
    )
    after, _ = full_drive(PARAMS, state, inputs, DriveHooks(spring=(count, unchanged)))
    np.testing.assert_allclose(after.memory["spring"][0], 2.5e-3, rtol=1e-5)
    assert after.memory["spring"][1] is None


def test_memories_that_do_not_fit_are_refused():
    zero = jnp.zeros(12)
    inputs = (
        JointCommand(zero, zero, zero),
        JointMeasurement(zero, zero, zero, zero),
        JointMotion(zero, zero, zero, zero),
    )
    few = initial_state(PARAMS, zero, zero, memory={"spring": (zero,)})
    with pytest.raises(ValueError, match="2 hooks at 'spring' need as many memories, the state has 1"):
        full_drive(PARAMS, few, inputs, DriveHooks(spring=(unchanged, unchanged)))
    without = initial_state(PARAMS, zero, zero)
    with pytest.raises(ValueError, match="returned a memory that the state does not carry"):
        full_drive(PARAMS, without, inputs, DriveHooks(command=(lambda v, s, m: (v, zero),)))
