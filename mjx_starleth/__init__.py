"""The 13 bodies in time: Moreau's step with hard contacts (paper II), the ground, the numbers of the robot.

`Bodies.step(params, state, input) -> (state, output)` is pure and sees one robot. The references behind the same
interface are imported from where they are: `mjx_starleth.mujoco_c.MujocoC`, `mjx_starleth.mjx_engine.make_mjx_engine`.
"""

from mjx_starleth.bodies import Bodies, make_bodies
from mjx_starleth.body_types import BodyInput, BodyOutput, BodyParams, BodyState, nominal_params
from mjx_starleth.mjcf import mjcf
from mjx_starleth.names import JOINT_NAMES, JOINTS, LEGS
from mjx_starleth.numbers import RobotNumbers, load_numbers, robot_numbers
from mjx_starleth.terrain import GroundContact, Terrain, ground_contact, plane, slope_normal

__all__ = [
    "JOINTS",
    "JOINT_NAMES",
    "LEGS",
    "Bodies",
    "BodyInput",
    "BodyOutput",
    "BodyParams",
    "BodyState",
    "GroundContact",
    "RobotNumbers",
    "Terrain",
    "ground_contact",
    "load_numbers",
    "make_bodies",
    "mjcf",
    "nominal_params",
    "plane",
    "robot_numbers",
    "slope_normal",
]
