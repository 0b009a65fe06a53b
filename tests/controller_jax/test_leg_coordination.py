"""Roles, events and reflexes of one leg at a time against a table; what is remembered, over simulated steps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from controller_jax import leg_coordination as coordination
from controller_jax.gait import LegPhases

PERIOD = 0.0025
PARAMS = coordination.CoordinationParams(
    late_lift_off=0.3, early_touch_down=0.6, tolerance=0.1, slip_distance=0.01, slip_speed=0.01,
    contact_hold=0.005, lowering=0.01, lowering_speed=0.5, raising=0.04,
)  # fmt: skip
PARAMS = jax.tree.map(jnp.float32, PARAMS)
STILL = np.zeros((4, 3))
UP = np.float32([0.0, 0.6, 0.8])  # normal of a slope
LONG = 1.0  # s without contact


@jax.jit
def tick(memory, stance, stance_phase, swing_phase, contact, soles, velocity):
    ones = jnp.ones(4)
    phases = LegPhases(stance * ones, stance_phase * ones, swing_phase * ones, 0.3 * ones, 0.3 * ones)
    return coordination.coordinate(PARAMS, memory, phases, contact * ones, soles, velocity, UP, jnp.float32(PERIOD))


def step(memory, stance, phase, contact, soles=STILL, velocity=STILL):
    f = lambda x: jnp.asarray(x, jnp.float32)  # noqa: E731
    in_stance, in_swing = (phase, 0.0) if stance else (1.0, phase)
    return tick(memory, f(stance), f(in_stance), f(in_swing), f(contact), f(soles), f(velocity))


def remembered(touched):
    memory = coordination.standing(jnp.zeros((4, 3)))
    return memory._replace(touched=jnp.full(4, touched, jnp.float32), air_time=jnp.full(4, LONG, jnp.float32))


# planned stance, phase of it, contact, touched before -> supports, event, reflex (- lower, + raise)
TABLE = [
    (1, 0.05, 1, 0, 1, None, 0),
    (1, 0.50, 1, 1, 1, None, 0),
    (1, 0.05, 0, 0, 0, None, -1),
    (1, 0.30, 0, 0, 0, "late_touch_down", -1),
    (1, 0.50, 0, 1, 0, "lost_contact", -1),
    (1, 0.95, 0, 1, 0, "early_lift_off", 0),
    (0, 0.05, 1, 1, 0, None, 0),
    (0, 0.20, 1, 1, 0, "late_lift_off", 0),
    (0, 0.45, 1, 0, 0, "obstacle", 1),
    (0, 0.80, 1, 0, 1, "early_touch_down", 0),
    (0, 0.45, 0, 0, 0, None, 0),
    (0, 0.80, 0, 0, 0, None, 0),
]


@pytest.mark.parametrize("stance, phase, contact, touched, supports, event, reflex", TABLE)
def test_role_event_and_reflex(stance, phase, contact, touched, supports, event, reflex):
    _, roles, events = step(remembered(touched), stance, phase, contact)
    assert np.all(np.asarray(roles.support) == supports)
    raised = {name for name, value in events._asdict().items() if np.all(np.asarray(value) > 0)}
    assert raised == ({event} if event else set())
    assert np.all(np.asarray(roles.seek) == (reflex < 0))
    np.testing.assert_allclose(roles.raising, 0.04 if reflex > 0 else 0.0, rtol=1e-6)


def test_a_foot_seeks_the_ground_below_where_it_was_at_its_own_speed():
    lost, thrown = np.full((4, 3), 0.3), np.full((4, 3), 0.4)
    memory, *_ = step(remembered(1.0), 1, 0.3, 1, soles=lost)
    for _ in range(10):  # 2 ticks of holding, 8 of seeking
        memory, roles, _ = step(memory, 1, 0.4, 0, soles=thrown)
    start = thrown - 0.01 * UP  # where it was when the search began
    np.testing.assert_allclose(memory.sought_W, start - 8 * PERIOD * 0.5 * UP, rtol=1e-5)
    assert np.all(np.asarray(roles.seek) == 1.0)


def test_a_bouncing_foot_keeps_pushing_for_a_moment():
    memory, *_ = step(remembered(0.0), 1, 0.2, 1)
    supports = []
    for _ in range(4):
        memory, roles, _ = step(memory, 1, 0.3, 0)
        supports.append(bool(np.all(np.asarray(roles.support) > 0)))
    assert supports == [True, True, False, False]
    memory, roles, _ = step(memory, 1, 0.4, 1)
    assert np.all(np.asarray(roles.support) == 1.0)
    _, roles, _ = step(memory, 0, 0.1, 0)  # planned to swing: no holding
    assert np.all(np.asarray(roles.support) == 0.0)


def test_slip_needs_both_distance_and_speed():
    memory = remembered(0.0)
    slow, fast = np.full((4, 3), [0.008, 0, 0]), np.full((4, 3), [0.5, 0, 0])
    for k in range(100):  # 2 mm of creep
        memory, roles, events = step(memory, 1, 0.1 + 0.001 * k, 1, velocity=slow)
        assert not np.any(events.slip)
    slipped = []
    for _ in range(12):  # 1.25 mm a tick
        memory, roles, events = step(memory, 1, 0.3, 1, velocity=fast)
        slipped.append(bool(np.all(np.asarray(events.slip) > 0)))
        assert np.all(np.asarray(roles.support) == (not slipped[-1]))
    assert slipped == [False] * 6 + [True] * 6  # 2 + 1.25 k mm pass 10 mm at k = 7
    assert np.all(np.asarray(roles.seek) == 1.0)
    _, _, events = step(memory, 1, 0.4, 1, velocity=slow)
    assert not np.any(events.slip)


def test_foothold_follows_contact_but_not_obstacles():
    memory = remembered(1.0)
    here, there = np.full((4, 3), 0.1), np.full((4, 3), 0.7)
    for stance, phase, contact, soles, expected in (
        (1, 0.5, 1, here, 0.1),  # stands
        (0, 0.1, 0, there, 0.1),  # in the air
        (0, 0.45, 1, there, 0.1),  # hits an obstacle
        (0, 0.9, 1, there, 0.7),  # lands early
    ):
        memory, *_ = step(memory, stance, phase, contact, soles)
        np.testing.assert_allclose(memory.foothold_W, expected, rtol=1e-6)


def test_swing_starts_when_the_foot_really_leaves():
    memory = remembered(1.0)
    memory, roles, _ = step(memory, 0, 0.2, 1)
    np.testing.assert_allclose(roles.swing_progress, 0.0)
    memory, roles, _ = step(memory, 0, 0.6, 0)
    np.testing.assert_allclose(roles.swing_progress, 0.5, rtol=1e-5)
    memory, roles, _ = step(memory, 0, 1.0, 0)
    np.testing.assert_allclose(roles.swing_progress, 1.0, rtol=1e-5)
    memory, *_ = step(memory, 1, 0.1, 1)
    _, roles, _ = step(memory, 0, 0.25, 0)
    np.testing.assert_allclose(roles.swing_progress, 0.25, rtol=1e-5)


def test_clearance_lasts_from_the_obstacle_to_the_next_stance():
    memory = remembered(0.0)
    memory, roles, _ = step(memory, 0, 0.45, 1)
    memory, roles, _ = step(memory, 0, 0.55, 0)
    np.testing.assert_allclose(roles.clearance, 0.04, rtol=1e-6)
    memory, *_ = step(memory, 1, 0.05, 1)
    _, roles, _ = step(memory, 0, 0.05, 0)
    np.testing.assert_allclose(roles.clearance, 0.0)


def test_touch_is_forgotten_in_the_next_swing():
    memory, *_ = step(remembered(1.0), 0, 0.1, 0)
    _, _, events = step(memory, 1, 0.3, 0)
    assert np.all(np.asarray(events.late_touch_down) > 0) and not np.any(events.lost_contact)
