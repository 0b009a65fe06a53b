"""What the controller knows of the robot, sees of its state and asks of its joints. SI; legs LF RF LH RH."""

from typing import NamedTuple, TypeAlias

import jax

Array: TypeAlias = jax.Array


class LegGeometry(NamedTuple):
    """The robot as its controller knows it: lengths, masses, limits. Links hang along -z at zero angles."""

    r_BH_B: Array  # (4, 3) HAA axis in the torso frame, m
    hip_length: Array  # () HAA to HFE, m
    thigh_length: Array  # () HFE to KFE, m
    shank_length: Array  # () KFE to the foot's centre, m
    foot_radius: Array  # () m
    torso_mass: Array  # () kg
    torso_com_B: Array  # (3,) m
    link_mass: Array  # (3,) hip, thigh, shank, kg
    link_com: Array  # (3,) distance of the link's centre of mass below its joint, m
    knee_sign: Array  # (4,) sign of KFE: -1 fore, +1 hind (X configuration)
    position_limits: Array  # (12, 2) rad, the joints' ranges less the software margin
    torque_limits: Array  # (12, 2) N m
    gravity: Array  # () m/s^2


class RobotState(NamedTuple):
    """State as the controller sees it, perfect or estimated."""

    r_WB: Array  # (3,) torso origin in the world, m
    R_WB: Array  # (3, 3) torso to world
    v_WB: Array  # (3,) velocity of the torso origin, world frame, m/s
    omega_B: Array  # (3,) angular velocity, torso frame, rad/s
    q: Array  # (12,) joint positions, rad
    qd: Array  # (12,) joint velocities, rad/s
    contact: Array  # (4,) 1.0 where the foot is on the ground (normal force >= 10 N, FACTS 1)


class JointTargets(NamedTuple):
    """What the controller asks of the joints for one control period; leg-major (12,)."""

    torque: Array  # N m, used where position_mode is 0
    position: Array  # rad, used where position_mode is 1
    position_mode: Array  # 0.0 or 1.0
