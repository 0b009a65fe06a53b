"""MJCF text of the 13-body robot, made from its numbers.

Bodies: torso, then hip, thigh and shank of LF, RF, LH, RH; free joint, then HAA, HFE, KFE of each leg. All links
hang along -z at zero angles (names.py). The joints have no armature: the rotor's inertia lives in the drive.
"""

from typing import Literal

from mjx_starleth.names import FORE_SIGN, JOINTS, LEFT_SIGN, LEGS
from mjx_starleth.numbers import Link, RigidBody, RobotNumbers


def mjcf(
    numbers: RobotNumbers,
    *,
    timestep: float = 2.5e-3,
    integrator: str = "implicitfast",
    solver_iterations: int = 100,
    cone: Literal["elliptic", "pyramidal"] = "elliptic",
    impratio: float = 1.0,
    solref: tuple[float, float] = (0.02, 1.0),
    contact: bool = True,
    armature: float = 0.0,
    damping: float = 0.0,
    position_gains: tuple[float, float] | None = None,
) -> str:
    """The robot as an MJCF document.

    contact: explicit pairs of the four foot spheres with the floor, nothing else ever collides.
    armature, damping: of every hinge, kg m^2 and N m s/rad.
    position_gains: (N m/rad, N m s/rad) of one position servo per joint; without them there are no actuators.
    """
    b = numbers.bodies
    legs = "".join(_leg(numbers, *leg) for leg in zip(LEGS, FORE_SIGN, LEFT_SIGN, strict=True))
    friction = numbers.contact.friction
    pairs = "".join(
        f'<pair name="{leg}" geom1="floor" geom2="{leg}_foot" condim="3" friction="{friction} {friction} 0 0 0"'
        f' solref="{_text(*solref)}"/>'
        for leg in LEGS
    )
    servos = ""
    if position_gains is not None:
        kp, kd = position_gains
        servos = "".join(
            f'<general joint="{leg}_{joint}" biastype="affine" gainprm="{kp}" biasprm="0 {-kp} {-kd}"/>'
            for leg in LEGS
            for joint in JOINTS
        )
    return f"""<mujoco model="starleth">
<option timestep="{timestep}" gravity="0 0 {-numbers.gravity}" integrator="{integrator}" solver="Newton"
 iterations="{solver_iterations}" cone="{cone}" impratio="{impratio}"><flag eulerdamp="disable"/></option>
<default><joint armature="{armature}" damping="{damping}"/><geom contype="0" conaffinity="0" mass="0"/></default>
<worldbody><geom name="floor" type="plane" size="0 0 1"/>
<body name="torso" pos="0 0 {numbers.default_stance.base_height}"><freejoint name="base"/>
{_inertial(b.torso)}{legs}</body></worldbody>
<contact>{pairs if contact else ""}</contact>
<actuator>{servos}</actuator>
</mujoco>"""


def _leg(numbers: RobotNumbers, leg: str, fore: float, left: float) -> str:
    b = numbers.bodies
    hip, foot = b.haa_in_torso, f"0 0 {-b.foot.centre_from_knee}"
    return (
        _link(f"{leg}_HIP", (fore * hip.x, left * hip.y, hip.z), b.hip, f"{leg}_HAA", "1 0 0")
        + _link(f"{leg}_THIGH", (0, 0, -b.hip.length), b.thigh, f"{leg}_HFE", "0 1 0")
        + _link(f"{leg}_SHANK", (0, 0, -b.thigh.length), b.shank, f"{leg}_KFE", "0 1 0")
        + f'<geom name="{leg}_foot" type="sphere" size="{b.foot.radius}" pos="{foot}"/>'
        + f'<site name="{leg}_foot" pos="{foot}"/></body></body></body>'
    )


def _link(name: str, position: tuple[float, ...], link: Link, joint: str, axis: str) -> str:
    return f'<body name="{name}" pos="{_text(*position)}">{_inertial(link)}<joint name="{joint}" axis="{axis}"/>'


def _inertial(body: RigidBody) -> str:
    return f'<inertial pos="{_text(*body.com)}" mass="{body.mass}" diaginertia="{_text(*body.inertia_diagonal)}"/>'


def _text(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)
