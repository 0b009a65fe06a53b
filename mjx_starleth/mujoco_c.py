"""MuJoCo C at small steps with its own contact: a reference for replay that shares no solver with this package.

`MujocoC` holds a model with the same numbers as BodyParams and moves a BodyState (as NumPy) through one control
period in sub-steps. The joint torque is asked for at every sub-step, so a drive may run beside it at its own rate.
"""

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np

from mjx_starleth.mjcf import mjcf
from mjx_starleth.names import LEGS
from mjx_starleth.numbers import RobotNumbers

SUBSTEP = 1e-4  # s
# A stiff, critically damped contact whose time constant is a few sub-steps, with hardly any sliding in stiction.
CONTACT_SOLREF = (4e-4, 1.0)
IMPRATIO = 100.0


class PeriodResult(NamedTuple):
    """One control period, NumPy float64."""

    q: np.ndarray  # (19,)
    u: np.ndarray  # (18,)
    contact_force: np.ndarray  # (4, 3) mean on the feet, world frame, N
    r_WF: np.ndarray  # (4, 3) centres of the feet at the end, m
    slip_velocity: np.ndarray  # (4, 3) of the feet's lowest points at the end, m/s
    gap: np.ndarray  # (4,) m


class MujocoC:
    """The robot in MuJoCo C with the numbers of a BodyParams (masses, friction, slope, joint stops)."""

    def __init__(self, numbers: RobotNumbers, params, substep: float = SUBSTEP) -> None:
        text = mjcf(numbers, timestep=substep, solref=CONTACT_SOLREF, impratio=IMPRATIO)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        self.substep = substep
        m = self.model
        m.body_mass[1:] = np.asarray(params.mass)
        m.body_ipos[1:] = np.asarray(params.com)
        m.body_inertia[1:] = np.asarray(params.inertia)
        m.opt.gravity[:] = np.asarray(params.gravity)
        m.pair_friction[:, :2] = np.broadcast_to(np.asarray(params.friction), (4,))[:, None]
        normal = np.asarray(params.terrain.normal, float)
        if len(params.terrain.obstacle_height) or len(params.terrain.patch_friction):
            raise ValueError("MuJoCo C replays planes only; remove obstacles and friction patches.")
        floor = m.geom("floor").id
        m.geom_pos[floor] = normal * float(params.terrain.offset)
        quaternion = np.zeros(4)
        mujoco.mju_quatZ2Vec(quaternion, normal)
        m.geom_quat[floor] = quaternion
        m.jnt_limited[1:] = 1
        m.jnt_range[1:] = np.asarray(params.joint_stop)
        m.jnt_solref[1:] = (-float(params.stop_stiffness) * 20.0, -float(params.stop_damping) * 20.0)
        mujoco.mj_setConst(m, self.data)
        self.normal, self.radius = normal, float(params.foot_radius)
        self.feet = [m.site(f"{leg}_foot").id for leg in LEGS]
        self.foot_geom = {m.geom(f"{leg}_foot").id: i for i, leg in enumerate(LEGS)}

    def period(
        self,
        q: np.ndarray,
        u: np.ndarray,
        torque: Callable[[int, np.ndarray, np.ndarray], np.ndarray],
        wrench_W: np.ndarray,
        steps: int,
    ) -> PeriodResult:
        """Move through `steps` sub-steps; torque(k, joint positions, joint velocities) -> (12,) N m."""
        m, d = self.model, self.data
        d.qpos[:], d.qvel[:] = q, u
        force = np.zeros((4, 3))
        for k in range(steps):
            d.qfrc_applied[6:] = torque(k, d.qpos[7:], d.qvel[6:])
            d.xfrc_applied[1] = wrench_W
            mujoco.mj_step(m, d)
            force += self._contact_forces()
        mujoco.mj_forward(m, d)
        r_WF = np.array([d.site_xpos[i] for i in self.feet])
        jacobian, velocity = np.zeros((3, m.nv)), np.zeros((4, 3))
        for i, foot in enumerate(self.feet):
            point = r_WF[i] - self.radius * self.normal
            mujoco.mj_jac(m, d, jacobian, None, point, m.site_bodyid[foot])
            velocity[i] = jacobian @ d.qvel
        gap = r_WF @ self.normal - self.radius
        return PeriodResult(d.qpos.copy(), d.qvel.copy(), force / steps, r_WF, velocity, gap)

    def _contact_forces(self) -> np.ndarray:
        """Force of the ground on each foot now, (4, 3) world frame."""
        found, local = np.zeros((4, 3)), np.zeros(6)
        for c in range(self.data.ncon):
            contact = self.data.contact[c]
            foot = self.foot_geom.get(contact.geom2, self.foot_geom.get(contact.geom1))
            if foot is None:
                continue
            mujoco.mj_contactForce(self.model, self.data, c, local)
            world = contact.frame.reshape(3, 3).T @ local[:3]
            found[foot] += world if contact.geom2 in self.foot_geom else -world
        return found
