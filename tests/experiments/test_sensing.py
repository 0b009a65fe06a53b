"""What the controllers are told: from outside it is the truth, from the IMU it follows from it."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np

from experiments.imu_sensing import make_sensing
from experiments.model import nominal_model
from experiments.sensing import NOISE
from experiments.trial import NOISE_COLUMNS
from mjx_starleth.rotation import rotation_matrix
from sea_jax import JointMeasurement

PERIOD = 2.5e-3  # s
HALF = np.deg2rad(20.0)
TILTED = np.r_[0.1, -0.2, 0.4, np.cos(HALF), np.sin(HALF), 0.0, 0.0]  # rolled by 40 degrees
JOINTS = np.linspace(-0.3, 0.3, 12)
LOADED = np.array([[0.0, 0.0, 60.0], [0.0, 0.0, 0.0], [0.0, 0.0, 5.0], [3.0, 0.0, 40.0]])
QUIET = jnp.zeros(NOISE_COLUMNS)


def plant(velocity: np.ndarray, force: np.ndarray = LOADED) -> SimpleNamespace:
    """A tilted robot whose torso moves at a velocity (6,), linear in the world frame, angular in its own."""
    q, u = np.r_[TILTED, JOINTS], np.r_[velocity, np.zeros(12)]
    bodies = SimpleNamespace(q=jnp.asarray(q, jnp.float32), u=jnp.asarray(u, jnp.float32))
    return SimpleNamespace(bodies=bodies, contact_force=jnp.asarray(force, jnp.float32))


MEASURED = JointMeasurement(*jnp.float32([JOINTS, np.zeros(12), np.ones(12), JOINTS + 0.1]))


def test_from_outside_all_is_seen_as_it_is() -> None:
    sensing = make_sensing("direct", nominal_model())
    velocity = np.array([0.3, -0.1, 0.2, 0.5, -0.6, 0.7])
    seen = plant(velocity)
    _, robot, joints = sensing.step(sensing.start(seen), seen, MEASURED, QUIET)
    np.testing.assert_allclose(robot.r_WB, TILTED[:3], rtol=1e-6)
    np.testing.assert_allclose(robot.R_WB, rotation_matrix(seen.bodies.q[3:7]), rtol=1e-6)
    np.testing.assert_allclose(np.r_[robot.v_WB, robot.omega_B], velocity, rtol=1e-6)
    np.testing.assert_array_equal(robot.contact, [1, 0, 0, 1])
    jax.tree.map(np.testing.assert_array_equal, joints, MEASURED)


def test_noise_tilts_the_torso_about_its_own_axes() -> None:
    sensing, seen = make_sensing("direct", nominal_model()), plant(np.zeros(6))
    _, robot, _ = sensing.step((), seen, MEASURED, QUIET.at[52].set(3.0))
    turn = np.asarray(rotation_matrix(seen.bodies.q[3:7])).T @ np.asarray(robot.R_WB)
    angle = 3.0 * NOISE.base_orientation
    np.testing.assert_allclose(turn, np.eye(3) + angle * np.array([[0, 0, 1], [0, 0, 0], [-1, 0, 0]]), atol=1e-6)


def test_the_imu_of_a_tilted_robot_tells_how_it_moves() -> None:
    """Half a second without a foot on the ground: what the filter's biases leave, and no part of gravity."""
    sensing = make_sensing("estimated", nominal_model())
    rate = np.float32([1.0, -0.5, 0.8])  # m/s^2

    def tick(state, k):
        seen = plant(np.zeros(6), np.zeros((4, 3)))
        seen.bodies.u = seen.bodies.u.at[:3].set((k + 1.0) * PERIOD * rate)
        state, robot, _ = sensing.step(state, seen, MEASURED, QUIET)
        return state, robot

    ticks = 200
    _, seen = jax.jit(lambda state: jax.lax.scan(tick, state, jnp.arange(ticks, dtype=jnp.float32)))(
        sensing.start(plant(np.zeros(6)))
    )
    np.testing.assert_allclose(seen.v_WB[-1], ticks * PERIOD * rate, atol=0.1)
    np.testing.assert_allclose(seen.R_WB[-1], rotation_matrix(jnp.float32(TILTED[3:])), atol=0.02)
