"""StarlETH for MuJoCo C, written out from the numbers file: one model and one MjData per log, 0.1 ms steps.

The torso is clamped (`fixed_base`) or free on a plane (`ground`). What a hidden effect changes in the bodies is
gathered in a `BodyChanges`; left at its defaults, the model text is the nominal robot's to the character.
"""

import copy
from dataclasses import dataclass, field

import mujoco
import numpy as np

from experiments.independent_plant.drive import STEP
from experiments.independent_plant.numbers import (
    FORE,
    JOINT_NAMES,
    KINDS,
    LEFT,
    LEGS,
    LINKS,
    MIRROR,
    Array,
    BodyNumbers,
    numbers_file,
)

CLAMP_HEIGHT = 1.0  # m, of the clamped torso
UNSTABLE = [getattr(mujoco.mjtWarning, f"mjWARN_BAD{of}") for of in ("QPOS", "QVEL", "QACC")]
# Contact as stiff as 0.1 ms steps bear: 66 N on a foot sink it by well under 0.1 mm.
CONTACT = 'solref="0.002 1" solimp="0.98 0.995 0.0005 0.5 2"'
FRICTION_LOSS = 'solreffriction="0.001 1" solimpfriction="0.99 0.999 0.001 0.5 2"'
AXES = {"HAA": "1 0 0", "HFE": "0 1 0", "KFE": "0 1 0"}
TILE_MASS = 0.1  # kg, of the patch of soft ground that a foot moves


@dataclass
class BodyChanges:
    """What hidden effects change in the bodies of one log."""

    payload_mass: float = 0.0  # kg, a point fixed to the torso
    payload_position: Array = field(default_factory=lambda: np.zeros(3))  # m, torso frame
    added_link_mass: Array = field(default_factory=lambda: np.zeros(12))  # kg, below each joint
    coulomb_drag: Array = field(default_factory=lambda: np.zeros(12))  # N m, at the joints
    viscous_drag: Array = field(default_factory=lambda: np.zeros(12))  # N m s/rad, at the joints
    friction_change: float = 0.0  # on the ground's friction coefficient
    compliance: float = 0.0  # m/N of the ground below each foot
    compliance_damping: float = 0.0  # N s/m
    slope_x: float = 0.0  # rad, the ground rises along x
    slope_y: float = 0.0  # rad, the ground rises along y
    end_stops: bool = True
    pendulum_mass: float = 0.0  # kg, sloshing on the torso
    pendulum_length: float = 0.1  # m
    pendulum_damping: float = 0.0  # N m s/rad


def _text(*values: float) -> str:
    return " ".join(f"{value:.10g}" for value in values)


def _leg(leg: int, numbers: BodyNumbers, changes: BodyChanges) -> str:
    """The three links of one leg, nested."""
    bodies, name = numbers_file()["bodies"], LEGS[leg]
    place = bodies["haa_in_torso"]
    offsets = [
        (FORE[leg] * place["x"], LEFT[leg] * place["y"], place["z"]),
        (0.0, 0.0, -bodies["hip"]["length"]),
        (0.0, 0.0, -bodies["thigh"]["length"]),
    ]
    text = ""
    for i, (kind, link) in enumerate(zip(KINDS, LINKS)):
        body, joint = bodies[link], 3 * leg + i
        scale = numbers.link_mass[i] + changes.added_link_mass[joint] / body["mass"]
        low, high = sorted(MIRROR[joint] * np.array(numbers_file()["joint_limits_LF"][kind]))
        drag = f' damping="{_text(changes.viscous_drag[joint])}"' if changes.viscous_drag[joint] else ""
        if changes.coulomb_drag[joint]:
            drag += f' frictionloss="{_text(changes.coulomb_drag[joint])}" {FRICTION_LOSS}'
        text += (
            f'<body name="{name}_{link}" pos="{_text(*offsets[i])}">'
            f'<inertial pos="{_text(*(numbers.link_com[i] * np.array(body["com"])))}"'
            f' mass="{_text(scale * body["mass"])}"'
            f' diaginertia="{_text(*(scale * np.array(body["inertia_diagonal"])))}"/>'
            f'<joint name="{name}_{kind}" axis="{AXES[kind]}" range="{_text(low, high)}"'
            f' limited="{"true" if changes.end_stops else "false"}"{drag}/>'
        )
    foot = bodies["foot"]
    text += (
        f'<geom name="{name}" type="sphere" size="{_text(foot["radius"])}"'
        f' pos="0 0 {_text(-foot["centre_from_knee"])}" mass="0" contype="0" conaffinity="0"/>'
        f'<site name="{name}" size="0.05" pos="0 0 {_text(-foot["centre_from_knee"])}"/>'
    )
    return text + "</body>" * 3


def _ground(changes: BodyChanges) -> str:
    """One plane for all feet, or a sprung tile below each foot."""
    quaternion = _text(*slope_quaternion(changes))
    if not changes.compliance:
        return f'<geom name="ground" type="plane" size="0 0 1" quat="{quaternion}" contype="0" conaffinity="0"/>'
    tiles = "".join(
        f'<body name="tile_{leg}" gravcomp="1"><joint name="tile_{leg}" type="slide" axis="0 0 1"'
        f' stiffness="{_text(1.0 / changes.compliance)}" damping="{_text(changes.compliance_damping)}"/>'
        f'<geom name="ground_{leg}" type="box" size="2 2 0.1" pos="0 0 -0.1" mass="{TILE_MASS}"'
        f' contype="0" conaffinity="0"/></body>'
        for leg in LEGS
    )
    return f'<body name="soft_ground" quat="{quaternion}">{tiles}</body>'


def slope_quaternion(changes: BodyChanges) -> Array:
    """Attitude of the ground: rises by slope_x along x and by slope_y along y."""
    quaternion, pitch, roll = np.zeros(4), np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(pitch, np.array([0.0, 1.0, 0.0]), -changes.slope_x)
    mujoco.mju_axisAngle2Quat(roll, np.array([1.0, 0.0, 0.0]), changes.slope_y)
    mujoco.mju_mulQuat(quaternion, pitch, roll)
    return quaternion


def model_text(experiment: str, numbers: BodyNumbers, changes: BodyChanges) -> str:
    """The MJCF of one log. `experiment` is `fixed_base` or `ground`."""
    spec, torso = numbers_file(), numbers_file()["bodies"]["torso"]
    free = experiment == "ground"
    friction = max(0.0, spec["contact"]["friction"] * numbers.ground_friction + changes.friction_change)
    extras = ""
    if changes.payload_mass:
        extras += (
            f'<body name="payload" pos="{_text(*changes.payload_position)}"><inertial pos="0 0 0"'
            f' mass="{_text(changes.payload_mass)}" diaginertia="1e-6 1e-6 1e-6"/></body>'
        )
    if changes.pendulum_mass:
        damping = _text(changes.pendulum_damping)
        extras += (
            f'<body name="pendulum" pos="0 0 0.1"><joint name="pendulum_x" axis="1 0 0" damping="{damping}"/>'
            f'<joint name="pendulum_y" axis="0 1 0" damping="{damping}"/>'
            f'<inertial pos="0 0 {_text(-changes.pendulum_length)}" mass="{_text(changes.pendulum_mass)}"'
            ' diaginertia="1e-5 1e-5 1e-5"/></body>'
        )
    legs = "".join(_leg(leg, numbers, changes) for leg in range(4))
    touch = "".join(f'<touch site="{leg}"/>' for leg in LEGS)
    tile = changes.compliance > 0.0
    pairs = "".join(
        f'<pair geom1="{f"ground_{leg}" if tile else "ground"}" geom2="{leg}" condim="3"'
        f' friction="{_text(friction, friction)} 0 0 0" {CONTACT}/>'
        for leg in LEGS
    )
    return (
        '<mujoco><compiler autolimits="false" angle="radian"/>'
        f'<option timestep="{STEP}" gravity="0 0 {-spec["gravity"]}"'
        ' integrator="Euler" solver="Newton" cone="elliptic" impratio="10" iterations="20" tolerance="1e-10"/>'
        f'<worldbody><body name="torso" pos="0 0 {CLAMP_HEIGHT}">'
        f'{"<freejoint/>" if free else ""}<inertial pos="{_text(*torso["com"])}"'
        f' mass="{_text(numbers.torso_mass * torso["mass"])}" diaginertia='
        f'"{_text(*(numbers.torso_mass * np.array(torso["inertia_diagonal"])))}"/>{legs}{extras}</body>'
        f"{_ground(changes) if free else ''}</worldbody>{f'<contact>{pairs}</contact>' if free else ''}"
        f"<sensor>{touch}</sensor></mujoco>"
    )


class Bodies:
    """The bodies of a batch: copies of all joint angles and speeds (B, 12) out, torques in, 0.1 ms on."""

    def __init__(self, texts: list[str]) -> None:
        self.models = [mujoco.MjModel.from_xml_string(text) for text in texts]
        self.datas = [mujoco.MjData(model) for model in self.models]
        self.free = self.models[0].jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
        joint = self.models[0].joint(JOINT_NAMES[0])
        angles, speeds = (slice(a, a + 12) for a in (joint.qposadr[0], joint.dofadr[0]))
        self._speeds = speeds
        self._position = [data.qpos[angles] for data in self.datas]
        self._velocity = [data.qvel[speeds] for data in self.datas]
        self._effort = [data.qfrc_applied[speeds] for data in self.datas]
        self._links = [self.models[0].jnt_bodyid[self.models[0].joint(name).id] for name in JOINT_NAMES]
        self._joints = [self.models[0].joint(name).id for name in JOINT_NAMES]
        self._torso = self.models[0].body("torso").id
        self._rows = list(zip(self.models, self.datas, self._effort))
        self._refresh()

    def _refresh(self) -> None:
        self.position, self.velocity = np.array(self._position), np.array(self._velocity)

    def place(self, joint_position: Array, torso_position: Array, torso_orientation: Array) -> None:
        """At rest: (B, 12) rad, (B, 3) m, (B, 4) unit quaternion; the torso's pose only where it is free."""
        for i, data in enumerate(self.datas):
            self._position[i][:] = joint_position[i]
            if self.free:
                data.qpos[:3], data.qpos[3:7] = torso_position[i], torso_orientation[i]
        for model, data in zip(self.models, self.datas):
            mujoco.mj_forward(model, data)
        self._refresh()

    def step(self, torque: Array) -> None:
        """One 0.1 ms under joint torques (B, 12), N m."""
        for (model, data, effort), row in zip(self._rows, torque):
            effort[:] = row
            mujoco.mj_step(model, data)
        self._refresh()

    def push(self, force: Array) -> None:
        """From now on: a force on the torso's origin, world frame (B, 3), N."""
        for data, row in zip(self.datas, force):
            data.xfrc_applied[self._torso, :3] = row

    def torso_pose(self) -> tuple[Array, Array]:
        """World position (B, 3) and orientation (B, 4) of the torso frame."""
        poses = np.array([data.qpos[:7] for data in self.datas])
        return poses[:, :3], poses[:, 3:]

    def torso_velocity(self) -> tuple[Array, Array]:
        """World linear (B, 3) and torso-frame angular velocity (B, 3)."""
        speeds = np.array([data.qvel[:6] for data in self.datas])
        return speeds[:, :3], speeds[:, 3:]

    def foot_force(self) -> Array:
        """Normal force on each foot, (B, 4), N."""
        return np.array([data.sensordata for data in self.datas])

    def radial_load(self) -> Array:
        """Force across each joint, less its part along the axis, (B, 12), N."""
        forces, axes = np.empty((len(self.datas), 12, 3)), np.empty((len(self.datas), 12, 3))
        for i, (model, data) in enumerate(zip(self.models, self.datas)):
            mujoco.mj_rnePostConstraint(model, data)
            forces[i], axes[i] = data.cfrc_int[self._links, 3:], data.xaxis[self._joints]
        along = (forces * axes).sum(axis=-1, keepdims=True)
        return np.linalg.norm(forces - along * axes, axis=-1)

    def lightened(self, log: int, mass: Array) -> mujoco.MjModel:
        """A copy of one log's model with `mass` (12,) [kg] taken off the links, their inertia in proportion."""
        model = copy.copy(self.models[log])
        links = np.array(self._links)
        share = 1.0 - mass / model.body_mass[links]
        model.body_mass[links] *= share
        model.body_inertia[links] *= share[:, None]
        return model

    def inverse(self, log: int, model: mujoco.MjModel | None = None) -> Array:
        """Joint torques (12,) that one log's motion takes, contact apart; with another model if one is given."""
        model, true = model or self.models[log], self.datas[log]
        data, torque = mujoco.MjData(model), np.empty(model.nv)
        data.qpos[:], data.qvel[:], data.qacc[:] = true.qpos, true.qvel, true.qacc
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, torque)
        return torque[self._speeds]

    def fallen(self) -> Array:
        """Whether the bodies left all reason: not a number, or the torso on the ground or far above it."""
        height = self.torso_pose()[0][:, 2] if self.free else np.full(len(self.datas), CLAMP_HEIGHT)
        # MuJoCo begins anew from its reference pose where numbers are huge or none
        reset = [any(data.warning[kind].number for kind in UNSTABLE) for data in self.datas]
        return np.array(reset) | ~np.isfinite(self.velocity).all(axis=1) | ~((height > 0.12) & (height < 3.0))
