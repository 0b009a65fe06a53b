"""Force distribution against an exact solver on random and on recorded problems; limits, warm start, odd cases."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from exact_distribution import Problem, Weights, cost, net_wrench, solve, violation
from reference_robot import GEOMETRY, random_stance
from scipy.spatial.transform import Rotation

from controller_jax.force_distribution import (
    DistributionSettings,
    ForceDistribution,
    Iterations,
    SupportLegs,
    distribute_forces,
    init_distribution,
)
from controller_jax.joint_torques import weight_torque
from controller_jax.leg_kinematics import inverse_kinematics, leg_kinematics
from controller_jax.rotations import control_frame, mm, mv

RECORDED = Path(__file__).parents[1] / "data" / "jump_distributions.npz"  # of three jumps, by data/record_jumps.py
FORCE_TOLERANCE = 0.1  # N, and
TORQUE_TOLERANCE = 0.01  # N m: what the limits have to be kept to
COST_TOLERANCE = 0.01  # of the optimal cost
COST_ROUNDING = 1e-3  # of a cost that is 1e-5 * 1e5 N^2 where the wrench is reached: float32 of the residual, squared
WRENCH_WEIGHT = np.array([1.0, 1.0, 1.0, 20.0, 20.0, 5.0])
BATCH = 500
JUMPS, JUMP_TICKS = 3, 560  # recorded, one after the other
UPRIGHT = 0.95  # cosine of the tilt
CALLED_SOLVED = 0.95  # share of the problems called solved that are within 1 %; 0.98 measured
PUSHED_SHARE = 0.75  # the same of jumps that are pushed over; 0.789 measured
WARM_SHARE = 0.99  # a change of contact or of many limits at once takes a tick or two more
COLD_START = Iterations(admm=20, polish=12)  # from zero; in the loop, warm-started, fewer do
LIMITS = np.asarray(GEOMETRY.torque_limits, float).reshape(4, 3, 2)


def settings(friction: float = 0.7, minimal_normal: float = 2.0, torque_limits: np.ndarray = LIMITS):
    """The same numbers for the package and for the oracle."""
    ours = DistributionSettings(
        wrench_weight=jnp.asarray(WRENCH_WEIGHT, jnp.float32),
        regularizer=jnp.float32(1e-5),
        friction=jnp.float32(friction),
        minimal_normal=jnp.float32(minimal_normal),
        torque_limits=jnp.asarray(torque_limits.reshape(12, 2), jnp.float32),
    )
    return ours, Weights(WRENCH_WEIGHT, 1e-5, friction, minimal_normal, torque_limits)


def random_problems(count: int, seed: int, partial_load: bool = False) -> tuple[SupportLegs, jax.Array]:
    """Feet about under the hips, any legs standing, torso tilted; wrenches up to twice what the legs can give."""
    rng = np.random.default_rng(seed)
    feet = jnp.asarray(np.stack([random_stance(rng) for _ in range(count)]))
    legs = jax.jit(jax.vmap(lambda r: leg_kinematics(GEOMETRY, inverse_kinematics(GEOMETRY, r))))(feet)
    R_CB = Rotation.from_rotvec(rng.normal(0, 0.15, (count, 3))).as_matrix()[:, None]
    up_B = np.swapaxes(R_CB, 2, 3)[..., 2]
    m_leg = float(GEOMETRY.link_mass.sum())
    weight = 9.81 * m_leg * np.einsum("nlij,nli->nlj", np.asarray(legs.J_BG_B), np.broadcast_to(up_B, (count, 4, 3)))
    load = (rng.random((count, 4)) < 0.75) | (rng.random((count, 1)) < 0.4)
    load = np.where(load.any(1, keepdims=True), load, 1.0)
    if partial_load:
        load = load * rng.uniform(0.1, 1.0, (count, 4))
    lift = rng.uniform(0, 2.2 * 263, count) * load.mean(1)
    wrench = np.column_stack([rng.normal(0, 60, (count, 2)), lift, rng.normal(0, 15, (count, 3))])
    r = np.einsum("nlij,nlj->nli", np.broadcast_to(R_CB, (count, 4, 3, 3)), legs.r_BF_B)
    arrays = (r, R_CB @ np.asarray(legs.J_BF_B), weight, load)
    return SupportLegs(*(jnp.asarray(a, jnp.float32) for a in arrays)), jnp.asarray(wrench, jnp.float32)


def plain(legs: SupportLegs, wrench: jax.Array, i: int) -> Problem:
    return Problem(*(np.asarray(a[i], float) for a in legs), np.asarray(wrench[i], float))


def excess_cost(weights: Weights, legs: SupportLegs, wrench: jax.Array, force: jax.Array, name: str) -> np.ndarray:
    """Cost over the exact optimum, relative, of every problem with a leg on the ground; all limits must be kept."""
    excess, missed = [], []
    for i in np.flatnonzero(np.asarray(legs.load).max(1) > 0):
        problem, ours = plain(legs, wrench, i), np.asarray(force[i], float)
        best = solve(weights, problem)
        assert best is not None
        assert not ours[problem.load == 0].any()
        optimum = cost(weights, problem, best)
        excess.append((cost(weights, problem, ours) - optimum) / (optimum + COST_ROUNDING))
        missed.append(violation(weights, problem, ours))
    excess, (cone, torque) = np.array(excess), np.max(missed, 0)
    within = 100 * (excess < COST_TOLERANCE).mean()
    print(
        f"\n{len(excess)} {name}: limits missed by at most {max(cone, 0):.1e} N, {max(torque, 0):.1e} N m;"
        f" cost over the optimum: largest {100 * excess.max():.2g} %, {within:.2f} % of the problems within 1 %"
    )
    assert cone < FORCE_TOLERANCE and torque < TORQUE_TOLERANCE
    return excess


@jax.jit
def _cold(ours: DistributionSettings, legs: SupportLegs, wrench: jax.Array) -> ForceDistribution:
    solve_one = lambda leg, b: distribute_forces(ours, init_distribution(), leg, b, COLD_START)[1]  # noqa: E731
    return jax.vmap(solve_one)(legs, wrench)


@jax.jit
def _loop(ours: DistributionSettings, legs: SupportLegs, wrench: jax.Array, fresh: jax.Array) -> ForceDistribution:
    def tick(state, problem):
        *problem, fresh = problem
        state = jax.tree.map(lambda new, old: jnp.where(fresh, new, old), init_distribution(), state)
        return distribute_forces(ours, state, *problem)

    return jax.vmap(lambda *problems: jax.lax.scan(tick, init_distribution(), problems)[1])(legs, wrench, fresh)


def in_the_loop(ours: DistributionSettings, legs: SupportLegs, wrench: jax.Array, warm: bool) -> ForceDistribution:
    """Solutions in the few steps of the control loop, each problem warm from the one before in its jump, or cold.

    One program serves both: problems of any number are laid out as those of the recorded jumps are.
    """
    count, ticks = len(wrench), JUMP_TICKS
    fill = lambda x: np.concatenate([x, np.repeat(x[-1:], JUMPS * ticks - count, 0)])  # noqa: E731
    by_jump = lambda x: fill(np.asarray(x)).reshape(JUMPS, ticks, *x.shape[1:])  # noqa: E731
    legs, wrench = jax.tree.map(by_jump, (legs, wrench))
    forces = _loop(ours, legs, wrench, np.full((JUMPS, ticks), not warm))
    return jax.tree.map(lambda x: np.asarray(x).reshape(-1, *x.shape[2:])[:count], forces)


def cold(ours: DistributionSettings, legs: SupportLegs, wrench: jax.Array) -> ForceDistribution:
    """Solutions from a cold start, in batches of one size: one compiled program serves all tests."""
    count = len(wrench)
    pad = -count % BATCH
    fill = lambda x: np.concatenate([x, np.repeat(x[-1:], pad, 0)]).reshape(-1, BATCH, *x.shape[1:])  # noqa: E731
    legs, wrench = jax.tree.map(fill, (jax.tree.map(np.asarray, legs), np.asarray(wrench)))
    parts = [_cold(ours, jax.tree.map(lambda x, i=i: x[i], legs), wrench[i]) for i in range(len(wrench))]
    return jax.tree.map(lambda *rows: np.concatenate(rows)[:count], *parts)


@pytest.fixture(scope="module")
def problems() -> tuple[SupportLegs, jax.Array, jax.Array]:
    """1000 problems and their solutions from a cold start."""
    legs, wrench = random_problems(1000, seed=0)
    return legs, wrench, cold(settings()[0], legs, wrench).force


def test_random_problems_from_a_cold_start(problems):
    excess = excess_cost(settings()[1], *problems, "random problems")
    assert len(excess) == 1000 and excess.max() < COST_TOLERANCE


def test_legs_partly_loaded():
    legs, wrench = random_problems(300, seed=1, partial_load=True)
    ours, weights = settings()
    excess = excess_cost(weights, legs, wrench, cold(ours, legs, wrench).force, "problems of partly loaded legs")
    assert excess.max() < COST_TOLERANCE


def test_load_shares_the_weight_in_proportion():
    legs, _ = random_problems(1, seed=2)
    square = np.array([[1, 1, -1.5], [1, -1, -1.5], [-1, 1, -1.5], [-1, -1, -1.5]]) * 0.2
    load = jnp.array([0.5, 1.0, 1.0, 0.5])  # diagonal partners differ: symmetric, so that no torque is needed
    legs = SupportLegs(jnp.asarray(square, jnp.float32), 1e-3 * legs.J_BF_C[0], jnp.zeros((4, 3)), load)
    limits = np.tile([-1e3, 1e3], (4, 3, 1))
    wrench = jnp.array([0.0, 0.0, 300.0, 0.0, 0.0, 0.0])
    one = jax.tree.map(lambda x: np.asarray(x)[None], legs)
    forces = cold(settings(torque_limits=limits)[0], one, np.asarray(wrench)[None])
    np.testing.assert_allclose(forces.force[0, :, 2], [50, 100, 100, 50], rtol=1e-3)


def recorded_problems() -> tuple[SupportLegs, jax.Array, np.ndarray]:
    """Tick by tick as the controller of the jump set them up, and where the torso was upright."""
    recorded = {name: jnp.asarray(x) for name, x in np.load(RECORDED).items()}

    def one(q, R_WB, load):
        legs, R_CB = leg_kinematics(GEOMETRY, q), control_frame(R_WB, jnp.array([0.0, 0.0, 1.0])).T @ R_WB
        weight = weight_torque(GEOMETRY, legs, R_WB)
        return SupportLegs(mv(R_CB[None], legs.r_BF_B), mm(R_CB[None], legs.J_BF_B), weight, load)

    legs = jax.jit(jax.vmap(one))(recorded["q"], recorded["R_WB"], recorded["load"])
    return legs, recorded["wrench"], np.asarray(recorded["R_WB"][:, 2, 2]) > UPRIGHT


def test_recorded_problems_of_a_robot_on_its_feet():
    """From a cold start all of them; with the few steps of the loop nearly all of an undisturbed jump's.

    Two of the three jumps are pushed over. Beyond 18 deg of tilt the interior point of a leg may not be found: then
    its torque limit is missed by up to 0.2 N m (force_problem.py), which is left out here.
    """
    legs, wrench, upright = recorded_problems()
    ours, weights = settings(friction=0.6)  # the jump's

    warm = in_the_loop(ours, legs, wrench, warm=True).force
    alone = np.asarray(cold(ours, legs, wrench).force)
    first = np.arange(len(upright)) < len(upright) // JUMPS
    part = lambda chosen, force: (*jax.tree.map(lambda x: np.asarray(x)[chosen], (legs, wrench)), force[chosen])  # noqa: E731
    undisturbed = excess_cost(weights, *part(first, warm), "recorded problems of an undisturbed jump, in the loop")
    pushed = excess_cost(weights, *part(upright & ~first, warm), "recorded problems of pushed jumps, in the loop")
    excess = excess_cost(weights, *part(upright, alone), "recorded problems of all jumps, cold start")
    assert len(excess) >= 1000 and excess.max() < COST_TOLERANCE
    assert (undisturbed < COST_TOLERANCE).mean() > WARM_SHARE
    assert (pushed < COST_TOLERANCE).mean() > PUSHED_SHARE


def test_residuals_tell_solved_from_unsolved(problems):
    """Cut short from a cold start, far beyond what the loop asks of it."""
    legs, wrench, _ = problems
    ours, weights = settings()
    short = in_the_loop(ours, legs, wrench, warm=False)
    solved = np.asarray((short.step_left < 0.01) & (short.pull_left < 1e-4))
    excess = excess_cost(weights, legs, wrench, short.force, "random problems, cut short")
    assert 0.2 < solved.mean() < 1.0
    right = (excess[solved] < COST_TOLERANCE).mean()
    print(f"{100 * solved.mean():.1f} % called solved, {100 * right:.2f} % of these within 1 %")
    assert right > CALLED_SOLVED
    assert (excess[~solved] < COST_TOLERANCE).mean() < right - 0.2


def test_wrench_reported_is_that_of_the_forces():
    legs, wrench = random_problems(1, seed=3)
    forces = cold(settings()[0], legs, wrench)
    expected = net_wrench(plain(legs, wrench, 0), np.asarray(forces.force[0], float))
    np.testing.assert_allclose(forces.wrench[0], expected, atol=1e-3)


def test_unreachable_minimal_normal_force_keeps_cone_and_normal_force_and_stays_finite():
    legs, wrench = random_problems(200, seed=4)
    ours, weights = settings(minimal_normal=500.0)  # far beyond 30 N m at the knee
    force = cold(ours, legs, wrench).force
    assert np.isfinite(force).all()
    for i in range(len(wrench)):
        problem = plain(legs, wrench, i)
        assert solve(weights, problem) is None
        cone, _ = violation(weights, problem, np.asarray(force[i], float))
        assert cone < FORCE_TOLERANCE


def test_no_leg_on_the_ground_gives_no_force():
    legs, wrench = random_problems(1, seed=5)
    forces = cold(settings()[0], legs._replace(load=jnp.zeros((1, 4))), wrench)
    np.testing.assert_array_equal(forces.force, 0.0)
    np.testing.assert_array_equal(forces.wrench, 0.0)


@pytest.mark.slow
def test_gradients_are_finite_and_right_where_the_active_limits_stay():
    legs, wrench = random_problems(20, seed=6)
    ours, _ = settings()

    def lift(b: jax.Array, legs: SupportLegs) -> jax.Array:
        return distribute_forces(ours, init_distribution(), legs, b, COLD_START)[1].wrench[2]

    gradient = jax.jit(jax.vmap(jax.grad(lift)))(wrench, legs)
    assert jnp.isfinite(gradient).all()
    value = jax.jit(jax.vmap(lift))
    up = jnp.array([[0.0, 0.0, 0.5, 0.0, 0.0, 0.0]])
    difference = value(wrench + up, legs) - value(wrench - up, legs)
    agree = jnp.abs(difference - gradient[:, 2]) < 0.02
    assert agree.mean() > 0.85  # the rest crosses a limit within the difference
