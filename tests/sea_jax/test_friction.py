"""Gear friction: it sticks exactly, gives way at its level, and brakes as c0 + c1 w + c2 w^3."""

import jax
import jax.numpy as jnp
import numpy as np
from drive_scenarios import NO_HOOKS, PARAMS
from scipy.integrate import solve_ivp

from sea_jax import DriveHooks, select_joints
from sea_jax.friction import coulomb_level, gear_friction, stick_or_slip
from sea_jax.hooks import no_signals
from sea_jax.motor import motor_step

STEP = 1e-4
# Semi-implicit Euler at 0.1 ms against the exact solution: the friction's slope lags by up to one step.
RELATIVE = 2e-3

HIP = select_joints(PARAMS, [0])
FREE = HIP._replace(spring_stiffness=0.0 * HIP.spring_stiffness, spring_damping=0.0 * HIP.spring_damping)


def spin(params, current, steps, velocity=0.0, radial_load=0.0, hooks=NO_HOOKS):
    """Velocities of a rotor under a current, A, after each step."""
    load = jnp.full(1, radial_load, jnp.float32)
    idle = no_signals(load, STEP)

    def step(carry, _):
        position, velocity = carry
        signals = idle._replace(motor_position=position, motor_velocity=velocity)
        after = motor_step(params, hooks, signals, jnp.full(1, current, jnp.float32), coulomb_level(params, load), {})
        return (after.position, after.velocity), (after.position, after.velocity)

    start = (jnp.zeros(1, jnp.float32), jnp.full(1, velocity, jnp.float32))
    positions, velocities = jax.lax.scan(step, start, length=steps)[1]
    return np.asarray(positions)[:, 0], np.asarray(velocities)[:, 0]


def breakaway_current(params, radial_load=0.0):
    level = float(params.friction_coulomb[0] + params.bearing_friction[0] * radial_load / params.gear_ratio[0])
    return level / float(params.torque_constant[0])


def test_below_its_level_nothing_moves_at_all():
    positions, velocities = spin(FREE, 0.999 * breakaway_current(FREE), 1000)
    assert np.all(velocities == 0.0)
    assert np.all(positions == 0.0)


def test_above_its_level_it_moves_both_ways():
    for sign in (1.0, -1.0):
        _, velocities = spin(FREE, sign * 1.001 * breakaway_current(FREE), 1000)
        assert np.all(sign * velocities > 0.0)


def test_a_coasting_motor_stops_and_stays():
    _, velocities = spin(FREE, 0.0, 1000, velocity=-0.5)
    stop = np.argmax(velocities == 0.0)
    c0, c1 = float(FREE.friction_coulomb[0]), float(FREE.friction_viscous[0])
    rotor = 0.5 * float(FREE.gear_ratio[0])
    expected = float(FREE.motor_inertia[0]) / c1 * np.log1p(c1 * rotor / c0) / STEP  # of c0 + c1 w
    assert abs(stop - expected) < 2.0  # steps
    assert np.all(velocities[stop:] == 0.0)
    assert np.all(np.diff(velocities[:stop]) > 0.0)


def test_radial_load_holds_against_more_current():
    load = 400.0
    _, velocities = spin(FREE, 0.999 * breakaway_current(FREE, load), 100, radial_load=-load)
    assert np.all(velocities == 0.0)
    _, velocities = spin(FREE, 1.001 * breakaway_current(FREE, load), 100, radial_load=load)
    assert velocities[-1] > 0.0


def test_run_up_with_cubic_friction_follows_the_differential_equation():
    params = FREE._replace(friction_cubic=jnp.full(1, 4e-10, jnp.float32))
    n = {name: float(value[0]) for name, value in params._asdict().items()}
    steps, current = 500, 3.0

    def rates(_, w):
        friction = n["friction_coulomb"] + n["friction_viscous"] * w + n["friction_cubic"] * w**3
        return (n["torque_constant"] * current - friction) / n["motor_inertia"]

    times = STEP * np.arange(1, steps + 1)
    rotor = solve_ivp(rates, (0.0, times[-1]), [0.0], t_eval=times, rtol=1e-9, atol=1e-9).y[0]
    _, velocities = spin(params, current, steps)
    assert n["friction_cubic"] * rotor[-1] ** 3 > 0.3 * n["torque_constant"] * current  # the cube matters
    np.testing.assert_allclose(velocities * n["gear_ratio"], rotor, rtol=0, atol=RELATIVE * rotor[-1] + rotor[0])


def test_a_level_below_zero_does_not_push():
    less = DriveHooks(friction=(lambda f, s, m: (f._replace(coulomb=f.coulomb - 1.0, smooth=0.0 * f.smooth), m),))
    _, velocities = spin(FREE, 0.0, 100, velocity=0.5, hooks=less)
    np.testing.assert_array_equal(velocities, 0.5)


def test_parts_have_the_signs_of_a_brake():
    velocity = jnp.asarray([-3.0], jnp.float32)
    friction = gear_friction(HIP, coulomb_level(HIP, jnp.zeros(1)), velocity)
    assert friction.coulomb[0] > 0.0
    assert friction.smooth[0] < 0.0
    assert stick_or_slip(velocity, jnp.asarray([1.0], jnp.float32))[0] == -2.0
