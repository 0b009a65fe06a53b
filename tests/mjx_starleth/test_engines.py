"""The reference engines behind the bodies' interface: closed form, each other, and how they fail."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from body_scenarios import GRAVITY, LOCKED, MASS, NUMBERS, bodies

from mjx_starleth.body_types import BodyInput, BodyState, nominal_params
from mjx_starleth.mjx_engine import make_mjx_engine
from mjx_starleth.mujoco_c import MujocoC

FLIGHT, STANCE = 80, 240  # ticks of 2.5 ms; by then the soft contact has settled
PUSH = np.float32([30, -20, 10, 1, 2, -3])  # N and N m, on the flying robot


@pytest.fixture(scope="module")
def course():
    """(state, output) of STANCE periods of mjx.step, joints locked: the robot that flies, the robot that stands."""
    robot, engine = bodies(), make_mjx_engine(NUMBERS)
    flying, standing = robot.initial_state(base_height=3.0), robot.initial_state()
    flying = flying._replace(u=flying.u.at[:6].set(jnp.float32([0.5, -0.3, 1.0, 0.4, -0.2, 0.3])))
    start = jax.tree.map(lambda *x: jnp.stack(x), flying, standing)
    wrench = jnp.stack([jnp.asarray(PUSH), jnp.zeros(6)])

    def tick(state, _):
        acting = lambda w: BodyInput(jnp.zeros(12), jnp.asarray(LOCKED), w)  # noqa: E731
        after = jax.vmap(lambda s, w: engine.step(engine.params, s, acting(w)))(state, wrench)
        return after[0], after

    run = jax.jit(lambda state: jax.lax.scan(tick, state, None, length=STANCE)[1])
    return start, jax.tree.map(np.asarray, run(start))


def test_mjx_flies_as_mujoco_c_in_small_steps_does(course) -> None:
    start, (state, output) = course
    engine = MujocoC(NUMBERS)
    reference = BodyState(*(np.asarray(x[0]) for x in start))
    for _ in range(FLIGHT):
        reference, last = engine.step(reference, BodyInput(np.zeros(12), LOCKED, PUSH))
    end = FLIGHT - 1
    # steps of 2.5 ms fall h/2 g t = 2.5 mm further than small ones
    np.testing.assert_allclose(state.q[end, 0], reference.q, atol=3e-3)
    np.testing.assert_allclose(state.u[end, 0, :6], reference.u[:6], atol=0.02)
    np.testing.assert_allclose(output.v_WF[end, 0], last.v_WF, atol=0.02)
    assert not output.contact_force[:FLIGHT, 0].any()


def test_mjx_stands_still_and_carries_its_weight(course) -> None:
    _, (state, output) = course
    np.testing.assert_allclose(output.contact_force[-1, 1, :, 2].sum(), MASS * GRAVITY, rtol=0.01)
    np.testing.assert_allclose(output.gap[-1, 1], 0.0, atol=6e-3)  # its contact is soft
    assert np.abs(state.u[-1, 1, :6]).max() < 0.005


def test_mujoco_c_that_gives_up_says_so_and_leaves_no_file(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    engine, start = MujocoC(NUMBERS, nominal_params(NUMBERS)), bodies().initial_state()
    start = BodyState(*(np.asarray(x) for x in start))
    lost, _ = engine.step(start, BodyInput(np.full(12, 1e12)))
    assert np.isnan(lost.q).all() and np.isnan(lost.u).all()
    assert not list(tmp_path.iterdir())
    again, _ = engine.step(start, BodyInput(np.zeros(12), LOCKED))
    assert np.isfinite(again.q).all()
