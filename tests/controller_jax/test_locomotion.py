"""The composed controller on a plant that shares no code with it: one rigid body on massless legs that do as told."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from controller_jax import locomotion
from controller_jax.foothold import FootholdParams
from controller_jax.force_distribution import DistributionSettings
from controller_jax.gait import ReducedGait
from controller_jax.geometry import geometry_from_numbers
from controller_jax.leg_coordination import CoordinationParams
from controller_jax.leg_kinematics import inverse_kinematics, leg_kinematics
from controller_jax.swing_leg import SwingParams
from controller_jax.terrain_estimator import TerrainParams
from controller_jax.torso_motion import TorsoParams
from controller_jax.types import RobotState
from controller_jax.velocity_command import VelocityCommand, VelocityParams
from controller_jax.virtual_model import Gains, IntegralLimits
from mjx_starleth.numbers import load_numbers

GEOMETRY = geometry_from_numbers(load_numbers().model_dump(mode="json"))
PERIOD, GRAVITY = 2.5e-3, 9.81
MASS, RADIUS = 26.82, 0.02  # kg, and m of a foot; FACTS 1
# torso and the legs hanging from its corners, kg m^2: what one rigid body must have to turn like the robot
INERTIA = np.array([0.9, 1.35, 1.5])
STANCE = np.array([0.0, 0.691, -1.265] * 2 + [0.0, -0.691, 1.265] * 2, np.float32)
GAITS = {  # FACTS 3.3; height, share of the ballistic hop, lead of the speed
    "lateral_walk": ((1.5, 0.77, 0.77, 0.5, 0.5, 0.75), 0.41, 0.0, 0.0),
    "walking_trot": ((0.8, 0.5, 0.5, 0.5, 0.5, 0.5), 0.43, 0.0, 0.4),
    "running_trot": ((0.61, 0.3, 0.3, 0.5, 0.5, 0.5), 0.45, 1.0, 0.4),
    "pronk": ((0.42, 0.55, 0.55, 0.0, 0.0, 0.0), 0.45, 1.0, 0.0),
}
SPEED_TOLERANCE = 0.06  # m/s: nothing integrates the error here, and a gait with flight wanders by this over seconds
# Stiffness 640 N/m towards the middle of the feet (FACTS 3.1), which stay behind, takes back half of a lateral command.
LATERAL_SHARE = (0.4, 1.0)


def params(name, **torso):
    gait, height, hop, lead = GAITS[name]
    walk = name == "lateral_walk"
    tree = locomotion.GaitParams(
        gait=ReducedGait(*gait),
        start=locomotion.StartParams(0.2, 1.0, 0.12),
        velocity=VelocityParams(
            VelocityCommand(1.0, 0.3, 0.8),
            VelocityCommand(0.005, 0.05, 0.05),
            VelocityCommand(0.0, 0.0, 0.0),
            VelocityCommand(0.2, 0.1, 0.2),
        ),
        terrain=TerrainParams(0.05),
        coordination=CoordinationParams(0.3, 0.6, 0.1, 0.03, 0.1, 0.01, 0.01, 0.5, 0.04),
        torso=TorsoParams(
            **dict(
                height=height,
                once_per_cycle=(0.0, 0.0),
                twice_per_cycle=(0.0, 0.0),
                phase_shift=0.0,
                hop=hop,
                hop_pitch=0.0,
                speed_lead=(lead, 0.0),
                lowest_weight=0.2 if walk else 0.15,
                stance_fade=0.5 if walk else 0.7,
                swing_rise=0.5 if walk else 0.7,
                girdle_distance=0.505,
                slope_share=(1.0, 1.0),
            )
            | torso
        ),
        gains=Gains(
            (500.0 if walk else 0.0, 640.0, 600.0),
            (0.0,) * 3,
            (150.0, 100.0, 120.0),
            (400.0, 200.0, 0.0),
            (0.0,) * 3,
            (6.0, 9.0, 100.0),
            MASS,
            (0.0,) * 3,
        ),
        integral_limits=IntegralLimits(30.0, 10.0),
        distribution=DistributionSettings(
            (1.0, 1.0, 1.0, 20.0, 20.0, 5.0), 1e-5, 0.7, 2.0, np.asarray(GEOMETRY.torque_limits) * 4.0
        ),
        foothold=FootholdParams(0.0, 0.5, (1.1, 1.1), (0.0, 0.0), (0.0, 0.0), 0.5),
        swing=SwingParams(0.07, 0.0, 0.6, 0.3, 0.8, (0.0, 0.0, 0.0), 10.0),
    )
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), tree, is_leaf=lambda x: type(x) in (tuple, float))


class Body(NamedTuple):
    r: jax.Array
    R: jax.Array
    v: jax.Array
    omega: jax.Array  # world frame
    feet: jax.Array  # (4, 3) centres, world frame
    contact: jax.Array


def robot_state(body):
    """As the controller sees it; a foot in contact rolls on its lowest point, one in the air moves with the torso."""
    r_BF = (body.feet - body.r[None]) @ body.R
    q = inverse_kinematics(GEOMETRY, r_BF)
    omega_B, down_B = body.R.T @ body.omega, -RADIUS * body.R[2]
    to_sole = leg_kinematics(GEOMETRY, q).J_BF_B + jnp.cross(shank_axes(q), down_B, axisa=1, axisc=1)
    at_rest = -(body.v @ body.R)[None] - jnp.cross(omega_B[None], r_BF + down_B[None])
    qd = jnp.linalg.solve(to_sole, at_rest[..., None])[..., 0]
    qd = jnp.where(body.contact[:, None] > 0, qd, 0.0).reshape(12)
    return RobotState(body.r, body.R, body.v, omega_B, q, qd, body.contact)


def shank_axes(q):
    """Columns (4, 3, 3): angular velocity of each shank in B per rate of its joints; HAA turns about x."""
    haa = q.reshape(4, 3)[:, 0]
    x, y = jnp.broadcast_to(jnp.eye(3)[0], (4, 3)), jnp.stack([0 * haa, jnp.cos(haa), jnp.sin(haa)], -1)
    return jnp.stack([x, y, y], -1)


def move(body, robot, info, targets_feet):
    """Feet in support roll and push with the desired force; the others go where they are told, down to the ground."""
    R_WC = _frame(body.R)
    support = info.support[:, None] > 0
    force = jnp.where(support, info.force_C @ R_WC.T, 0.0)
    v = body.v + PERIOD * (force.sum(0) / MASS - jnp.array([0.0, 0.0, GRAVITY]))
    soles = body.feet - jnp.array([[0.0, 0.0, RADIUS]])
    torque = jnp.cross(soles - body.r[None], force).sum(0)
    inertia = body.R @ jnp.diag(jnp.asarray(INERTIA, jnp.float32)) @ body.R.T
    gyroscopic = jnp.cross(body.omega, inertia @ body.omega)
    omega = body.omega + PERIOD * jnp.linalg.inv(inertia) @ (torque - gyroscopic)
    turn = PERIOD * jnp.array([[0.0, -omega[2], omega[1]], [omega[2], 0.0, -omega[0]], [-omega[1], omega[0], 0.0]])
    R = jnp.linalg.qr(body.R + turn @ body.R)[0]
    R = R * jnp.sign(jnp.diagonal(body.R.T @ R))[None, :]
    r = body.r + PERIOD * v
    shank_W = (robot.omega_B[None] + jnp.einsum("kij,kj->ki", shank_axes(robot.q), robot.qd.reshape(4, 3))) @ body.R.T
    rolled = body.feet + PERIOD * jnp.cross(shank_W, jnp.array([[0.0, 0.0, RADIUS]])) * body.contact[:, None]
    feet = jnp.where(support, rolled, targets_feet)
    feet = feet.at[:, 2].set(jnp.maximum(feet[:, 2], RADIUS))
    reach = feet - (r[None] + jnp.asarray(HIPS) @ R.T)
    length = jnp.linalg.norm(reach, axis=1, keepdims=True)
    feet = jnp.where(length > LEG_LENGTH, feet - reach + reach * LEG_LENGTH / length, feet)
    return Body(r, R, v, omega, feet, (feet[:, 2] < RADIUS + 2e-4).astype(jnp.float32))


HIPS = np.array([[x, y, 0] for x in (0.2525, -0.2525) for y in (0.185, -0.185)], np.float32)
LEG_LENGTH = 0.5


def _frame(R):
    x = R[:, 0] * jnp.array([1.0, 1.0, 0.0])
    x = x / jnp.linalg.norm(x)
    return jnp.stack([x, jnp.array([-x[1], x[0], 0.0]), jnp.array([0.0, 0.0, 1.0])], 1)


@jax.jit
def begin():
    """Controller and body before the first tick."""
    feet = jnp.asarray(HIPS) + jnp.array([[0.0, 0.0, RADIUS]])
    zero, up = jnp.zeros(3), jnp.array([0.0, 0.0, 0.44])
    body = Body(up, jnp.eye(3), zero, zero, feet, jnp.ones(4))
    return locomotion.init(GEOMETRY, robot_state(body)), body


@jax.jit
def second(p, command, carry, ticks):
    """One second of the closed loop: motions of any length share its program."""

    def tick(carry, k):
        state, body = carry
        robot = robot_state(body)
        time = k.astype(jnp.float32) * PERIOD
        state, targets, info = locomotion.step(p, GEOMETRY, state, robot, command, time, jnp.float32(PERIOD))
        told = info.foot.position + jnp.array([[0.0, 0.0, RADIUS]])
        after = move(body, robot, info, told)
        return (state, after), (after, info, targets)

    return jax.lax.scan(tick, carry, ticks)


def walk(p, heading=0.0, lateral=0.0, turning=0.0, seconds=5):
    command = VelocityCommand(*(jnp.float32(x) for x in (heading, lateral, turning)))
    parts = []
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        carry = begin()
        for ticks in jnp.arange(seconds * round(1 / PERIOD)).reshape(seconds, -1):
            carry, part = second(p, command, carry, ticks)
            parts.append(jax.tree.map(np.asarray, part))
    return jax.tree.map(lambda *pieces: np.concatenate(pieces), *parts)


@pytest.mark.parametrize(
    "name, speed", [("lateral_walk", 0.15), ("walking_trot", 0.4), ("running_trot", 0.4), ("pronk", 0.4)]
)
def test_gait_reaches_its_speed_and_keeps_height_and_plan(name, speed):
    body, info, _ = walk(params(name), heading=speed)
    late = slice(len(body.v) // 2, None)
    assert body.R[:, 2, 2].min() > 0.97
    assert body.v[late, 0].mean() == pytest.approx(speed, abs=SPEED_TOLERANCE)
    assert abs(body.v[late, 1].mean()) < SPEED_TOLERANCE
    assert body.r[late, 2].mean() == pytest.approx(GAITS[name][1], abs=0.01)
    assert not info.events.slip[late].any()
    agree = (info.planned_stance[late] == body.contact[late]).mean()
    assert agree > 0.95, agree


@pytest.mark.parametrize("ahead", [-0.02, 0.02])
def test_the_mean_speed_is_learnt_where_footholds_miss_it(ahead):
    p = params("walking_trot")
    p = p._replace(foothold=p.foothold._replace(heading_offset=jnp.full(2, jnp.float32(ahead))))
    rate = VelocityCommand(*(jnp.float32(x) for x in (1.0, 0.0, 0.0)))
    trimmed = p._replace(velocity=p.velocity._replace(trim_rate=rate))
    plain, learnt = (walk(q, heading=0.3, seconds=8)[0].v[-1280:, 0].mean() for q in (p, trimmed))
    assert abs(plain - 0.3) > 0.03, plain
    assert learnt == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize("name, flight", [("running_trot", 0.4), ("pronk", 0.45), ("walking_trot", 0.0)])
def test_flight_phases_are_as_long_as_planned(name, flight):
    body, _, _ = walk(params(name))
    aloft = body.contact[len(body.v) // 2 :].sum(1) == 0
    assert aloft.mean() == pytest.approx(flight, abs=0.06)


def test_turning_and_lateral_commands_are_followed():
    body, _, _ = walk(params("walking_trot"), lateral=0.15, turning=0.4)
    late = slice(len(body.v) // 2, None)
    yaw = np.unwrap(np.arctan2(body.R[:, 1, 0], body.R[:, 0, 0]))
    assert np.diff(yaw[late]).mean() / PERIOD == pytest.approx(0.4, abs=0.06)
    v_C = np.einsum("tji,tj->ti", body.R[late], body.v[late])
    low, high = LATERAL_SHARE
    assert low * 0.15 < v_C[:, 1].mean() < high * 0.15


def test_standing_still_before_the_start():
    """All legs carry, nothing moves, and the torques are those of statics: foot under hip, a quarter each (FACTS 1)."""
    body, info, targets = walk(params("walking_trot", height=0.44))
    standing = slice(0, 75)
    assert np.all(info.support[standing] == 1) and np.all(targets.position_mode[standing] == 0)
    assert np.ptp(info.phase[standing]) == 0
    assert np.abs(body.v[standing]).max() < 0.01
    np.testing.assert_allclose(info.force_C[40].sum(0), [0, 0, MASS * GRAVITY], atol=3.0)
    knee = targets.torque[40].reshape(4, 3)[:, 2]
    # at 0.42 m from axis to foot the lever is 0.127 m (FACTS 1); the shank's own weight takes off 0.2 N m
    np.testing.assert_allclose(np.abs(knee), 0.25 * MASS * GRAVITY * 0.127, atol=0.5)
    np.testing.assert_array_equal(np.sign(knee), [1, 1, -1, -1])


def test_forces_are_planned_where_the_feet_touch():
    """A robot pushed ahead brakes; what the forces miss of the wrench is counted with lever arms to the soles."""
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        state, body = begin()
        body = body._replace(v=jnp.array([0.3, 0.0, 0.0]))
        still, now = VelocityCommand(*jnp.zeros(3)), jnp.zeros(())
        step = jax.jit(locomotion.step)
        _, _, info = step(params("walking_trot"), GEOMETRY, state, robot_state(body), still, now, jnp.float32(PERIOD))
    soles = np.asarray(body.feet) - np.asarray(body.r) - [0.0, 0.0, RADIUS]
    assert float(info.force_C[:, 0].sum()) < -20.0
    missed = np.cross(soles, np.asarray(info.force_C)).sum(0) - np.asarray(info.wrench_C[3:])
    np.testing.assert_allclose(missed, info.tracking_C[3:], atol=0.02)


def test_the_torso_does_not_leave_before_the_feet():
    _, info, _ = walk(params("walking_trot"), heading=0.4)
    first_step = np.argmin(info.planned_stance.min(1))
    assert 0.2 < first_step * PERIOD < 1.2, "between the stand and the end of the blend"
    assert np.all(info.command.heading[: first_step - round(0.5 / PERIOD)] == 0.0)
    assert info.command.heading[first_step] < 0.1
    assert info.command.heading[-1] == pytest.approx(0.4, abs=1e-3)


def test_legs_in_the_air_are_position_controlled_and_bear_no_force():
    _, info, targets = walk(params("running_trot"))
    in_air = info.support < 0.5
    assert in_air.mean() > 0.4
    np.testing.assert_array_equal(info.force_C[in_air], 0.0)
    np.testing.assert_array_equal(targets.position_mode.reshape(-1, 4, 3)[in_air], 1.0)
