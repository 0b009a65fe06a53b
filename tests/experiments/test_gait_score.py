"""What a gait is judged by: sums over control periods, and the cost terms from them."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.model import nominal_model
from experiments.tasks.definition import load_task
from experiments.tasks.gait import make_task
from experiments.tasks.gait_score import CONE_EDGE, FALLEN_HEIGHT, TERMS, GaitTally

UP = np.float32([0.0, 0.0, 1.0])
FEET = np.float32([[0.2, 0.2, 0.0], [0.2, -0.2, 0.0], [-0.2, 0.2, 0.0], [-0.2, -0.2, 0.0]])


@pytest.fixture(scope="module")
def judge():
    return make_task(load_task("running_trot"), nominal_model()).judge


def tick(time=100.0, height=0.4, velocity=(0.0, 0.0, 0.0), pressed=(1, 1, 1, 1), **info) -> SimpleNamespace:
    """One control period of a level robot with all legs planned to stand."""
    q = jnp.asarray([0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0, *(0.1, 0.5, -1.0) * 4], jnp.float32)
    force = 100.0 * np.float32(pressed)[:, None] * UP
    plan = {
        "plane": SimpleNamespace(normal_W=UP),
        "planned_stance": jnp.ones(4),
        "support": jnp.ones(4),
        "torso": SimpleNamespace(omega_W=jnp.zeros(3)),
        "force_C": jnp.asarray(force),
        "tracking_C": jnp.zeros(6),
    }
    slip = np.float32([0.3, 0.4, 0.0]) * np.ones((4, 1), np.float32)
    bodies = SimpleNamespace(r_WF=FEET, contact_force=force, slip_velocity=slip, contact_residual=jnp.float32(0.0))
    u = jnp.concatenate([jnp.asarray(velocity, jnp.float32), jnp.zeros(15)])
    after = SimpleNamespace(bodies=SimpleNamespace(q=q, u=u))
    return SimpleNamespace(
        time=jnp.float32(time), after=after, info=SimpleNamespace(**plan | info), output=SimpleNamespace(bodies=bodies)
    )


def test_a_period_on_plan_adds_the_way_made_and_the_slip_of_feet_that_press(judge) -> None:
    found = judge.observe(GaitTally.first(), tick(velocity=(0.4, -0.1, 0.0), pressed=(1, 1, 1, 0)))
    dt = judge.period
    np.testing.assert_allclose(found.velocity_C, [0.4 * dt, -0.1 * dt], rtol=1e-5)
    assert float(found.slip) == pytest.approx(3 * 0.5 * dt, rel=1e-4)
    assert float(found.schedule) == pytest.approx(0.25 * dt) and float(found.flight) == 0.0
    assert float(found.time) == float(found.upright) == pytest.approx(dt)


def test_in_the_air_all_feet_are_off_a_plan_to_stand(judge) -> None:
    found = judge.observe(GaitTally.first(), tick(pressed=(0, 0, 0, 0)))
    assert float(found.flight) == float(found.schedule) == pytest.approx(judge.period)


def test_nothing_but_standing_counts_before_the_gait_has_settled(judge) -> None:
    found = judge.observe(GaitTally.first(), tick(time=0.5 * judge.settled, velocity=(1.0, 0.0, 0.0)))
    assert float(found.upright) > 0.0 and float(found.time) == float(found.slip) == float(found.velocity_C[0]) == 0.0


def test_a_fallen_robot_stays_fallen(judge) -> None:
    down = judge.observe(GaitTally.first(), tick(height=0.9 * FALLEN_HEIGHT))
    again = judge.observe(down, tick())
    assert float(again.fallen) == 1.0 and float(again.upright) == float(again.time) == 0.0


def test_only_supporting_legs_are_charged_for_forces_near_the_cone(judge) -> None:
    share = CONE_EDGE + 0.1
    friction = float(judge.settings.distribution.friction)
    force = jnp.asarray(100.0 * np.float32([[share * friction, 0.0, 1.0]] * 4))
    found = judge.observe(GaitTally.first(), tick(force_C=force, support=jnp.asarray([1.0, 0.0, 0.0, 0.0])))
    assert float(found.cone) == pytest.approx(judge.period * 0.1 / 4, rel=1e-3)


def moved(q=None, u=None, **info) -> SimpleNamespace:
    """A control period with parts of the pose q (19,) and the velocity u (18,) set: index to value."""
    one = tick(**info)
    bodies = one.after.bodies
    for name, parts in (("q", q or {}), ("u", u or {})):
        for index, value in parts.items():
            setattr(bodies, name, getattr(bodies, name).at[index].set(value))
    return one


def test_unrest_is_rolling_and_pitching_off_the_plan_and_turning_is_counted_apart(judge) -> None:
    found = judge.observe(GaitTally.first(), moved(u={3: 0.3, 4: -0.4, 5: 9.0}))
    assert float(found.unrest) == pytest.approx(0.25 * judge.period, rel=1e-5)
    assert float(found.turned) == pytest.approx(9.0 * judge.period, rel=1e-5)
    planned = SimpleNamespace(omega_W=jnp.float32([0.3, 0.0, 0.0]))
    found = judge.observe(GaitTally.first(), moved(u={3: 0.3, 4: -0.4}, torso=planned))
    assert float(found.unrest) == pytest.approx(0.16 * judge.period, rel=1e-5)


@pytest.mark.parametrize("side", [0, 1])
def test_a_joint_is_charged_for_what_it_is_beyond_its_stop(judge, side: int) -> None:
    limits = judge.settings.geometry.position_limits
    middle = {7 + joint: x for joint, x in enumerate(np.mean(limits, 1))}
    for beyond, charged in ((0.1, 0.1), (-0.1, 0.0)):
        found = judge.observe(GaitTally.first(), moved(q=middle | {12: limits[5, side] + (2 * side - 1) * beyond}))
        assert float(found.joint_stop) == pytest.approx(judge.period * charged, abs=1e-7)


def test_the_way_made_is_along_and_across_the_torsos_heading(judge) -> None:
    quarter = {3: np.sqrt(0.5), 6: np.sqrt(0.5)}  # to the left
    found = judge.observe(GaitTally.first(), moved(q=quarter, u={0: -0.1, 1: 0.3}))
    np.testing.assert_allclose(found.velocity_C, judge.period * np.array([0.3, 0.1]), atol=1e-7)


def test_a_robot_on_its_side_has_fallen(judge) -> None:
    for angle, fallen in ((0.8, 0.0), (1.2, 1.0)):
        found = judge.observe(GaitTally.first(), moved(q={3: np.cos(angle / 2), 4: np.sin(angle / 2)}))
        assert float(found.fallen) == fallen


def test_the_cost_is_the_weighted_sum_of_rates(judge) -> None:
    command, flight = judge.settings.command, float(judge.settings.flight)
    tally = GaitTally.first()._replace(
        time=jnp.float32(4.0),
        upright=jnp.float32(judge.duration),
        velocity_C=jnp.float32([2.0, 0.4]),
        flight=jnp.float32(4.0 * 0.5 * flight),
        slip=jnp.float32(1.2),
        unrest=jnp.float32(1.0),
    )
    score = judge.score(tally, jnp.float32(0.0), jnp.float32(0.5))
    expected = {"speed": abs(0.5 - command.heading), "drift": abs(0.1 - command.lateral), "slip": 0.3, "unrest": 0.5}
    expected |= {"turning": abs(command.turning), "flight": 0.5}
    for name in TERMS:
        assert float(score.terms[name]) == pytest.approx(judge.weights[name] * float(expected.get(name, 0.0)), abs=1e-5)
    assert float(score.cost) == pytest.approx(sum(map(float, score.terms.values())), rel=1e-6)


def test_a_later_fall_costs_less_but_never_less_than_half(judge) -> None:
    def cost(upright: float, fallen: float = 1.0, failed: float = 0.0) -> float:
        tally = GaitTally.first()._replace(upright=jnp.float32(upright), fallen=jnp.float32(fallen))
        return float(judge.score(tally, jnp.float32(failed), jnp.float32(0.6)).terms["fall"])

    whole = judge.weights["fall"]
    assert [cost(0.0), cost(0.5 * judge.duration), cost(judge.duration)] == pytest.approx(
        [whole, 0.75 * whole, 0.5 * whole]
    )
    assert cost(0.0, fallen=0.0) == 0.0 and cost(0.0, fallen=0.0, failed=1.0) == pytest.approx(whole)


def test_a_cost_that_is_no_number_is_worse_than_a_fall(judge) -> None:
    score = judge.score(GaitTally.first()._replace(slip=jnp.float32(np.nan)), jnp.float32(0.0), jnp.float32(0.6))
    assert float(score.cost) == 2 * judge.weights["fall"]
