"""What goes into and comes out of the bodies' time step. SI, float32; legs LF RF LH RH x HAA HFE KFE."""

from typing import NamedTuple

import jax
import numpy as np

from mjx_starleth.names import JOINT_SIGN, JOINTS, LEGS
from mjx_starleth.numbers import RobotNumbers
from mjx_starleth.terrain import Terrain, plane

Array = jax.Array

# No value is published. As stiff as the drive's own knee stop, with enough damping not to bounce.
STOP_STIFFNESS = 300.0  # N m/rad
STOP_DAMPING = 2.0  # N m s/rad


class BodyParams(NamedTuple):
    """Everything about bodies and ground that may be searched, perturbed or fitted.

    Bodies: torso, then hip, thigh and shank of LF, RF, LH, RH.
    """

    mass: Array  # (13,) kg
    com: Array  # (13, 3) in the body's frame, m
    inertia: Array  # (13, 3) principal, along the body's axes about its com, kg m^2
    gravity: Array  # (3,) world frame, m/s^2
    foot_radius: Array  # () m
    terrain: Terrain
    friction: Array  # () between foot and ground, outside of patches
    restitution: Array  # () Newton's, normal
    compliance: Array  # () of the ground under one foot, m/N; 0 is exactly hard
    ground_damping: Array  # () beside that spring, N s/m
    joint_stop: Array  # (12, 2) rad
    stop_stiffness: Array  # () N m/rad
    stop_damping: Array  # () N m s/rad


class BodyState(NamedTuple):
    """What the scan carries."""

    q: Array  # (19,) r_WB, quaternion torso to world (w x y z), joints: MuJoCo's qpos
    u: Array  # (18,) v_WB in the world frame, omega_B in the torso frame, joint velocities: MuJoCo's qvel
    impulse: Array  # (4, 3) contact impulses of the last step, world frame, N s: the solver's first guess


class BodyInput(NamedTuple):
    """What acts on the bodies during one period; None is zero."""

    joint_torque: Array  # (12,) at the joint velocities of the period's start, N m
    joint_damping: Array | None = None  # (12,) >= 0, minus the derivative of that torque by velocity, N m s/rad
    wrench_W: Array | None = None  # (6,) force N and torque N m on the torso's origin, world frame
    generalised_force: Array | None = None  # (18,) dual to u


class BodyOutput(NamedTuple):
    """What happened in one period; feet are at its end."""

    contact_force: Array  # (4, 3) on the feet, world frame, mean over the period, N
    contact_residual: Array  # () largest violation of the contact laws by a foot, N
    gap: Array  # (4,) between foot and ground, m
    r_WF: Array  # (4, 3) centres of the feet, m
    v_WF: Array  # (4, 3) velocities of the feet's centres, m/s
    slip_velocity: Array  # (4, 3) velocity of each foot's point nearest to the ground, m/s
    joint_acceleration: Array  # (12,) mean over the period, rad/s^2


def nominal_params(numbers: RobotNumbers) -> BodyParams:
    """The robot of the numbers file on a hard, level plane."""
    b = numbers.bodies
    bodies = (b.torso, *(b.hip, b.thigh, b.shank) * len(LEGS))
    limits = [getattr(numbers.joint_limits_LF, joint) for joint in JOINTS] * len(LEGS)
    stops = [sorted(sign * limit for limit in pair) for sign, pair in zip(JOINT_SIGN, limits, strict=True)]
    return BodyParams(
        mass=np.float32([body.mass for body in bodies]),
        com=np.float32([body.com for body in bodies]),
        inertia=np.float32([body.inertia_diagonal for body in bodies]),
        gravity=np.float32([0, 0, -numbers.gravity]),
        foot_radius=np.float32(b.foot.radius),
        terrain=plane(),
        friction=np.float32(numbers.contact.friction),
        restitution=np.float32(numbers.contact.restitution),
        compliance=np.float32(0),
        ground_damping=np.float32(0),
        joint_stop=np.float32(stops),
        stop_stiffness=np.float32(STOP_STIFFNESS),
        stop_damping=np.float32(STOP_DAMPING),
    )


def nominal_stance(numbers: RobotNumbers) -> np.ndarray:
    """q (19,) of the default stance: level, over the world's origin, the feet on the ground.

    The file's base height counts from the centres of the feet, as the published poses do.
    """
    pose = numbers.default_stance.LF
    joints = np.array([pose.HAA, pose.HFE, pose.KFE] * len(LEGS)) * np.array(JOINT_SIGN)
    height = numbers.default_stance.base_height + numbers.bodies.foot.radius
    return np.float32([0, 0, height, 1, 0, 0, 0, *joints])
