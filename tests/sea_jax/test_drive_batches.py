"""What a search needs of the drives: the same bits anywhere in a batch, and finite gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from drive_scenarios import PARAMS

from sea_jax import DRIVES, JointCommand, JointMeasurement, JointMotion, initial_state

ZERO = jnp.zeros(12)
TICKS = 30


def rollout(drive, params, amplitude, position_mode):
    """End torques and total of a roll-out in which a link of 0.05 kg m^2 swings under its own drive."""

    def tick(carry, time):
        state, q, qd, torque = carry
        told = amplitude * jnp.sin(30.0 * time)
        command = JointCommand(told, 0.05 * told, position_mode)
        measurement = JointMeasurement(q, qd, torque, state.motor_position)
        motion = JointMotion(q, qd, jnp.zeros_like(q), jnp.full_like(q, 50.0))
        state, output = DRIVES[drive](params, state, (command, measurement, motion))
        qd = qd + 2.5e-3 * (output.torque - 5.0 * q) / 0.05
        return (state, q + 2.5e-3 * qd, qd, output.end_torque), output.end_torque

    start = (initial_state(params, ZERO, ZERO), ZERO, ZERO, ZERO)
    times = 2.5e-3 * jnp.arange(TICKS, dtype=jnp.float32)
    return jax.lax.scan(tick, start, times)[1]


def amplitudes(count):
    return jnp.asarray(np.random.default_rng(0).uniform(2.0, 20.0, (count, 12)), jnp.float32)


@pytest.mark.parametrize("drive", DRIVES)
def test_result_does_not_depend_on_the_place_in_the_batch(drive):
    mode = jnp.asarray([0.0, 1.0, 0.0] * 4)
    run = jax.jit(jax.vmap(lambda a: rollout(drive, PARAMS, a, mode)))
    batch = amplitudes(16)
    order = np.random.default_rng(1).permutation(16)
    np.testing.assert_array_equal(run(batch)[order], run(batch[order]))


@pytest.mark.parametrize("drive", DRIVES)
def test_gradients_with_respect_to_all_parameters_are_finite(drive):
    def total(params, amplitude, mode):
        return (rollout(drive, params, amplitude, mode) ** 2).sum()

    gradient = jax.jit(jax.grad(total, argnums=(0, 1)))
    for mode in (ZERO, ZERO + 1.0):
        slopes = gradient(PARAMS, amplitudes(1)[0], mode)
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slopes))
        assert np.any(np.abs(slopes[1]) > 1e-3)


def test_gradients_agree_with_finite_differences_where_the_drive_is_smooth():
    """Small motions without friction and saturation: the drive is then linear and differentiable."""
    params = PARAMS._replace(friction_coulomb=0.0 * PARAMS.friction_coulomb, bearing_friction=ZERO)

    def total(scale):
        stiff = params._replace(spring_stiffness=scale * params.spring_stiffness)
        return rollout("full", stiff, ZERO.at[0].set(0.3), ZERO)[-1, 0]

    one = jnp.float32(1.0)
    slope = float(jax.jit(lambda scale: jax.jvp(total, (scale,), (one,))[1])(one))
    run = jax.jit(total)
    difference = float(run(jnp.float32(1.02)) - run(jnp.float32(0.98))) / 0.04
    assert slope == pytest.approx(difference, rel=0.01)  # float32 over a difference of 4 %
    assert abs(slope) > 1e-3
