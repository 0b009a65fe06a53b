"""MuJoCo C in small steps behind the bodies' interface: an independent integrator and contact, for replays.

Everything is NumPy, one environment, and not pure: the engine owns an MjData. It takes the same BodyParams,
BodyState and BodyInput as Moreau's step and gives the same BodyOutput.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from mjx_starleth.body_types import BodyInput, BodyOutput, BodyParams, BodyState, nominal_params
from mjx_starleth.mujoco_model import mujoco_model
from mjx_starleth.names import LEGS
from mjx_starleth.numbers import RobotNumbers
from mjx_starleth.terrain import ground_contact

# (time since the period's start, joint positions (12,), joint velocities (12,)) -> joint torques (12,)
JointTorque = Callable[[float, np.ndarray, np.ndarray], np.ndarray]
BAD_STATE = [int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{what}")) for what in ("QPOS", "QVEL", "QACC")]


class MujocoC:
    """The robot in MuJoCo C.

    params: nominal on a level plane unless given. period: of one `step`, s. substep: of MuJoCo, s; the period must
    be a whole number of them. Raises ValueError if it is not, or if MuJoCo cannot do what the params ask.
    """

    def __init__(
        self,
        numbers: RobotNumbers,
        params: BodyParams | None = None,
        period: float = 2.5e-3,
        substep: float = 1.25e-4,
    ):
        self.substeps = round(period / substep)
        if self.substeps < 1 or abs(self.substeps * substep - period) > 1e-9:
            raise ValueError(f"The period ({period:g} s) must be a whole number of substeps ({substep:g} s).")
        self.params = nominal_params(numbers) if params is None else params
        self.period = period
        self.model = mujoco_model(numbers, self.params, substep)
        self.data = mujoco.MjData(self.model)
        self._sites = [self.model.site(f"{leg}_foot").id for leg in LEGS]
        self._foot_of_geom = {self.model.geom(f"{leg}_foot").id: i for i, leg in enumerate(LEGS)}
        self._foot_of_pair = np.array([self._foot_of_geom[geom] for geom in self.model.pair_geom2])

    def step(
        self, state: BodyState, input: BodyInput, torque: JointTorque | None = None
    ) -> tuple[BodyState, BodyOutput]:
        """One period. With `torque`, that function is asked in every substep and input.joint_torque only adds to it.

        The new state is NaN where MuJoCo has given up: it then starts again from its own rest pose.
        """
        m, d = self.model, self.data
        d.warning.number[:] = 0
        d.qpos[:], d.qvel[:] = state.q, state.u
        start = d.qvel[6:].copy()
        held = np.asarray(input.joint_torque, float)
        damping = np.zeros(12) if input.joint_damping is None else np.asarray(input.joint_damping, float)
        extra = np.zeros(18) if input.generalised_force is None else np.asarray(input.generalised_force, float)
        force = np.zeros((4, 3))
        for k in range(self.substeps):
            stop, stop_damping = self._joint_stops()
            own = 0.0 if torque is None else torque(k * m.opt.timestep, d.qpos[7:].copy(), d.qvel[6:].copy())
            m.dof_damping[6:] = damping + stop_damping  # linearly implicit in MuJoCo, too
            d.qfrc_applied[:] = extra
            d.qfrc_applied[6:] += held + damping * start + stop + own
            if input.wrench_W is not None:
                self._push_torso(np.asarray(input.wrench_W, float))
            if self.params.terrain.patch_friction.shape[0]:
                self._set_friction()
            with _without_log_file():
                mujoco.mj_step(m, d)
            force += self._foot_forces()
        force /= self.substeps
        if d.warning.number[BAD_STATE].any():
            d.qpos[:], d.qvel[:] = np.nan, np.nan
        new = BodyState(d.qpos.astype(np.float32), d.qvel.astype(np.float32), np.float32(force * self.period))
        return new, self._output(force, (d.qvel[6:] - start) / self.period)

    def energy(self, state: BodyState) -> tuple[float, float]:
        """Kinetic and potential energy, J."""
        m, d = self.model, self.data
        d.qpos[:], d.qvel[:] = state.q, state.u
        mujoco.mj_forward(m, d)
        mujoco.mj_energyPos(m, d)
        mujoco.mj_energyVel(m, d)
        return float(d.energy[1]), float(d.energy[0])

    def _joint_stops(self) -> tuple[np.ndarray, np.ndarray]:
        p, q, u = self.params, self.data.qpos[7:], self.data.qvel[6:]
        low, high = p.joint_stop[:, 0], p.joint_stop[:, 1]
        spring = p.stop_stiffness * (np.maximum(low - q, 0) + np.minimum(high - q, 0))
        pressing = spring * (spring - p.stop_damping * u) > 0
        return np.where(pressing, spring, 0), np.where(pressing, p.stop_damping, 0)

    def _push_torso(self, wrench_W: np.ndarray) -> None:
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, self.data.qpos[3:7])
        self.data.qfrc_applied[:3] += wrench_W[:3]
        self.data.qfrc_applied[3:6] += rotation.reshape(3, 3).T @ wrench_W[3:]

    def _set_friction(self) -> None:
        mujoco.mj_kinematics(self.model, self.data)
        friction = np.asarray(self._ground().friction)
        self.model.pair_friction[:, :2] = friction[self._foot_of_pair][:, None]

    def _ground(self):
        r_WF = self.data.site_xpos[self._sites].astype(np.float32)
        return ground_contact(self.params.terrain, r_WF, self.params.foot_radius, self.params.friction)

    def _foot_forces(self) -> np.ndarray:
        """Contact force on each foot in the world frame (4, 3) of the step just made, N."""
        forces, wrench = np.zeros((4, 3)), np.zeros(6)
        for i in range(self.data.ncon):
            contact = self.data.contact[i]
            if contact.efc_address < 0:
                continue
            mujoco.mj_contactForce(self.model, self.data, i, wrench)
            forces[self._foot_of_geom[contact.geom2]] += contact.frame.reshape(3, 3).T @ wrench[:3]
        return forces

    def _output(self, force: np.ndarray, joint_acceleration: np.ndarray) -> BodyOutput:
        m, d = self.model, self.data
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_comVel(m, d)
        ground = self._ground()
        radius, normal = float(self.params.foot_radius), np.asarray(ground.frame)[:, 2]
        velocity, turning, both = np.zeros((4, 3)), np.zeros((4, 3)), np.zeros(6)
        for i, site in enumerate(self._sites):
            mujoco.mj_objectVelocity(m, d, mujoco.mjtObj.mjOBJ_SITE, site, both, 0)
            turning[i], velocity[i] = both[:3], both[3:]
        return BodyOutput(
            contact_force=np.float32(force),
            contact_residual=np.float32(0),  # MuJoCo's laws are its own
            gap=np.asarray(ground.gap),
            r_WF=np.float32(d.site_xpos[self._sites]),
            v_WF=np.float32(velocity),
            slip_velocity=np.float32(velocity - np.cross(turning, radius * normal)),
            joint_acceleration=np.float32(joint_acceleration),
        )


@contextmanager
def _without_log_file() -> Iterator[None]:
    """MuJoCo tells of a diverging step by a line on stderr and a file in the working directory."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
