"""Contact schedules against brute-force tables; interpolation and velocity commands."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from controller_jax import gait
from controller_jax.velocity_command import VelocityCommand, VelocityParams, integrated_trim, smoothed_command

# FACTS 3.3: T, fore duty, hind duty, fore lag, hind lag, pair lag
GAITS = {
    "lateral_walk": (1.5, 0.77, 0.77, 0.5, 0.5, 0.75),
    "walking_trot": (0.8, 0.5, 0.5, 0.5, 0.5, 0.5),
    "running_trot": (0.61, 0.30, 0.30, 0.5, 0.5, 0.5),
    "bound": (0.45, 0.35, 0.35, 0.0, 0.0, 0.5),
    "pronk": (0.5, 0.4, 0.4, 0.0, 0.0, 0.0),
}
LEGS = ("LF", "RF", "LH", "RH")
ROUNDING = 1e-5  # phases are sums of float32


def reduced(name):
    return gait.ReducedGait(*(jnp.float32(x) for x in GAITS[name]))


def stance_table(name, phases):
    """Stance of every leg (phases, 4), from the definition: touches down at its lag, stands DF, cycle after cycle."""
    fore, hind, fore_lag, hind_lag, pair_lag = GAITS[name][1:]
    down = {"LF": 0.0, "RF": fore_lag, "LH": pair_lag, "RH": pair_lag + hind_lag}
    table = np.zeros((len(phases), 4), bool)
    for column, leg in enumerate(LEGS):
        duty = fore if leg[1] == "F" else hind
        for cycle in range(-3, 3):
            begin = down[leg] + cycle
            table[:, column] |= (phases >= begin) & (phases < begin + duty)
    return table


@pytest.mark.parametrize("name", GAITS)
def test_stance_follows_the_definition(name):
    phases = (np.arange(997) + 0.37) / 997
    pattern = gait.full_pattern(reduced(name))
    found = jax.vmap(lambda p: gait.leg_phases(pattern, p).stance)(jnp.asarray(phases, jnp.float32))
    np.testing.assert_array_equal(np.asarray(found) > 0, stance_table(name, phases))


@pytest.mark.parametrize("name", GAITS)
def test_phases_run_from_0_to_1_through_stance_and_swing(name):
    phases = np.arange(2000, dtype=np.float32) / 2000
    pattern = gait.full_pattern(reduced(name))
    legs = jax.tree.map(np.asarray, jax.vmap(lambda p: gait.leg_phases(pattern, p))(jnp.asarray(phases)))
    for leg in range(4):
        stands = legs.stance[:, leg] > 0
        for part, own, share in ((stands, legs.stance_phase, True), (~stands, legs.swing_phase, False)):
            inside = own[part, leg]
            start = np.argmin(inside)
            rolled = np.roll(inside, -start)
            assert rolled[0] < 0.01 and rolled[-1] > 0.98 and np.all(np.diff(rolled) > 0)
            duration = (legs.stance_duration if share else legs.swing_duration)[0, leg]
            assert duration == pytest.approx(part.mean() * GAITS[name][0], abs=2e-3)
        assert np.all(legs.swing_phase[stands, leg] == 0)


def test_a_leg_that_never_lifts_off_stands_at_every_phase():
    pattern = gait.standing(gait.full_pattern(reduced("running_trot")))
    phases = jnp.linspace(0.0, 1.0, 500)
    legs = jax.vmap(lambda p: gait.leg_phases(pattern, p))(phases)
    assert np.all(np.asarray(legs.stance) == 1) and np.all(np.isfinite(legs.swing_phase))


def test_wrap_stays_below_one():
    """A tiny negative phase rounds up to 1.0 in float32."""
    phase = np.concatenate([np.random.default_rng(0).uniform(-3, 3, 1000), [-1e-9, -1e-8, -1e-7, 1.0, 2.0, -1.0]])
    wrapped = np.asarray(gait.wrap(jnp.asarray(phase, jnp.float32)))
    assert wrapped.min() >= 0.0 and wrapped.max() < 1.0
    off = np.abs(wrapped - phase % 1.0)
    assert np.minimum(off, 1 - off).max() < 1e-6


def test_phase_comes_round_after_each_stride():
    pattern = gait.full_pattern(reduced("pronk"))
    phase, step = jnp.float32(0.0), jax.jit(lambda p: gait.advance(pattern, p, jnp.float32(0.0025)))
    for _ in range(200):
        phase = step(phase)
    assert min(float(phase), 1 - float(phase)) < 1e-4


def test_interpolation_meets_both_gaits_and_goes_the_short_way():
    start, end = gait.full_pattern(reduced("lateral_walk")), gait.full_pattern(reduced("running_trot"))
    for fraction, goal in ((0.0, start), (1.0, end)):
        between = gait.interpolate(start, end, jnp.float32(fraction))
        for found, wanted in zip(between, goal):
            np.testing.assert_allclose(gait.wrap(found), gait.wrap(wanted), atol=ROUNDING)
    half = gait.interpolate(start, end, jnp.float32(0.5))
    np.testing.assert_allclose(gait.duty_factors(half), 0.535, atol=ROUNDING)
    np.testing.assert_allclose(half.stride_duration, 1.055, atol=ROUNDING)
    # RH goes from 0.25 down to 0, LH from 0.75 to 0.5
    np.testing.assert_allclose(half.touch_down, [0.0, 0.5, 0.625, 0.125], atol=ROUNDING)


def velocity(values):
    return VelocityCommand(*(jnp.float32(v) for v in values))


def test_command_is_bounded_and_smoothed():
    bounds, shares, make = (1.0, 0.3, 0.8), (0.005, 0.05, 0.05), velocity
    params = VelocityParams(make(bounds), make(shares), make((0.0,) * 3), make((0.0,) * 3))
    command, expected = make((0, 0, 0)), np.zeros(3)
    for _ in range(300):
        command = smoothed_command(params, command, make((2.0, -0.1, 0.5)))
        expected += np.array(shares) * (np.array([1.0, -0.1, 0.5]) - expected)
    np.testing.assert_allclose([float(x) for x in command], expected, rtol=1e-4)


def test_trim_makes_up_for_a_share_of_the_speed_that_is_lost():
    rate, period = 0.8, 2.5e-3
    none = velocity((0.0, 0.0, 0.0))
    params = VelocityParams(none, none, velocity((rate, 0.0, rate)), velocity((1.0, 1.0, 0.05)))
    kept, command, trim = 0.85, velocity((0.4, 0.2, 0.5)), none
    step = jax.jit(lambda trim, measured: integrated_trim(params, trim, command, measured, jnp.float32(period)))
    for _ in range(1200):
        measured = jax.tree.map(lambda due, more: kept * (due + more), command, trim)
        trim = step(trim, measured)
    # x' = rate (v - kept (v + x)): an exponential towards v (1 - kept) / kept
    end = 0.4 * (1 - kept) / kept
    assert float(trim.heading) == pytest.approx(end * (1 - np.exp(-rate * kept * 1200 * period)), rel=2e-3)
    assert float(trim.lateral) == 0.0, "what has no rate learns nothing"
    assert float(trim.turning) == pytest.approx(0.05), "and what would need more stays at its clamp"
