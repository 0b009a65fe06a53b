"""The model text against the published geometry (FACTS 1), read by MuJoCo."""

import mujoco
import numpy as np
import pytest
from body_scenarios import GRAVITY, MASS, NUMBERS, mujoco_robot

from mjx_starleth.bodies import make_bodies
from mjx_starleth.names import JOINT_NAMES, LEGS

TABLE = 2e-3  # m, the table below is rounded to 1 mrad and 1 mm


def test_thirteen_bodies_and_no_rotor():
    m, _ = mujoco_robot(contact=True)
    assert (m.nbody - 1, m.nq, m.nv, m.npair) == (13, 19, 18, 4)
    assert np.isclose(m.body_mass.sum(), MASS, atol=1e-9)
    assert not m.dof_armature.any()
    assert tuple(m.joint(i).name for i in range(1, 13)) == JOINT_NAMES


@pytest.mark.parametrize(("height", "hfe", "kfe"), [(0.24, 1.362, -2.346), (0.35, 0.966, -1.742), (0.47, 0.43, -0.793)])
def test_feet_under_the_hips_at_the_published_angles(height, hfe, kfe):
    m, d = mujoco_robot()
    d.qpos[:7] = 0, 0, height, 1, 0, 0, 0
    d.qpos[7:] = [0, hfe, kfe] * 2 + [0, -hfe, -kfe] * 2
    mujoco.mj_kinematics(m, d)
    for leg, x, y in zip(LEGS, (1, 1, -1, -1), (1, -1, 1, -1), strict=True):
        foot = d.site(f"{leg}_foot").xpos
        np.testing.assert_allclose(foot, [x * 0.2525, y * 0.185, 0], atol=TABLE)


def test_end_stops_mirror_over_the_legs():
    stops = make_bodies(NUMBERS, dynamics="legs").params.joint_stop.reshape(4, 3, 2)
    np.testing.assert_allclose(stops[0], [[-0.40, 0.50], [-0.60, 1.29], [-2.46, -0.10]], atol=1e-6)
    np.testing.assert_allclose(stops[1], [[-0.50, 0.40], [-0.60, 1.29], [-2.46, -0.10]], atol=1e-6)
    np.testing.assert_allclose(stops[2], [[-0.40, 0.50], [-1.29, 0.60], [0.10, 2.46]], atol=1e-6)


def test_servos_hold_the_robot_up():
    m, d = mujoco_robot(contact=True, position_gains=(100.0, 2.0), armature=0.05)
    stance = make_bodies(NUMBERS, dynamics="legs").stance
    d.qpos[:], d.ctrl[:] = stance, stance[7:]
    for _ in range(800):
        mujoco.mj_step(m, d)
    assert d.ncon == 4 and 0.38 < d.qpos[2] < 0.44
    assert np.isclose(d.qfrc_constraint[2], MASS * GRAVITY, atol=0.1)
