"""A MuJoCo model of the robot with the numbers of a BodyParams: for the two reference engines.

MuJoCo's own contact is soft; here it is as stiff as its step allows. The floor is a plane, obstacles are height
fields on it.
"""

import math

import mujoco
import numpy as np

from mjx_starleth.body_types import BodyParams
from mjx_starleth.mjcf import mjcf
from mjx_starleth.names import LEGS
from mjx_starleth.numbers import RobotNumbers
from mjx_starleth.obstacle import obstacle_profile
from mjx_starleth.terrain import Terrain

HARDNESS = 0.999  # impedance of the contacts: 1 is rigid and singular
IMPRATIO = 100.0  # friction that much stiffer than the normal direction, or feet creep
GRID = 0.004  # m between the points of an obstacle's height field
MOST_POINTS = 200


def mujoco_model(numbers: RobotNumbers, params: BodyParams, timestep: float) -> mujoco.MjModel:
    """The robot on its ground. Raises ValueError for what MuJoCo's contact cannot do."""
    if float(params.compliance) > 0:
        raise ValueError("MuJoCo's contact has no compliance in m/N; replay a soft ground with the Moreau engine.")
    if np.any(np.asarray(params.terrain.obstacle_height) < 0):
        raise ValueError("Obstacles of negative height cannot be replayed in MuJoCo; its floor has no holes.")
    text = mjcf(numbers, timestep=timestep, cone="elliptic", impratio=IMPRATIO)
    spec = mujoco.MjSpec.from_string(text)
    for k in np.nonzero(np.asarray(params.terrain.obstacle_height))[0]:
        _add_obstacle(spec, params.terrain, int(k))
    m = spec.compile()
    set_params(m, params)
    return m


def set_params(m: mujoco.MjModel, params: BodyParams) -> None:
    """Masses, gravity, floor and contact of a model from `mujoco_model`; obstacles stay as they were built."""
    m.body_mass[1:], m.body_ipos[1:], m.body_inertia[1:] = params.mass, params.com, params.inertia
    m.opt.gravity[:] = params.gravity
    m.geom_size[_feet(m), 0] = params.foot_radius
    m.geom_rbound[_feet(m)] = params.foot_radius
    m.pair_friction[:, :2] = params.friction
    m.pair_solref[:] = contact_solref(float(params.restitution), m.opt.timestep)
    m.pair_solimp[:] = (HARDNESS, HARDNESS, 0.001, 0.5, 2.0)
    floor = m.geom("floor").id
    m.geom_quat[floor] = plane_quaternion(np.asarray(params.terrain.normal, float))
    m.geom_pos[floor] = np.asarray(params.terrain.normal) * float(params.terrain.offset)
    mujoco.mj_setConst(m, mujoco.MjData(m))


def contact_solref(restitution: float, timestep: float) -> tuple[float, float]:
    """Time constant and damping ratio of the stiffest stable contact: critically damped, or rebounding by e.

    A damped oscillator that is left at its rest position after half a period keeps exp(-pi z / sqrt(1 - z^2)) of its
    speed; at z = 1 nothing.
    """
    if restitution <= 0:
        return 2 * timestep, 1.0
    log = math.log(min(restitution, 0.999))
    return 2 * timestep, -log / math.hypot(math.pi, log)


def plane_quaternion(normal: np.ndarray) -> np.ndarray:
    """Orientation (4,) of a plane: z its normal, x the world's x axis projected on it (terrain.py)."""
    x = np.array([1.0, 0, 0]) - normal[0] * normal
    x /= np.linalg.norm(x)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.stack([x, np.cross(normal, x), normal], 1).ravel())
    return quaternion


def _feet(m: mujoco.MjModel) -> list[int]:
    return [m.geom(f"{leg}_foot").id for leg in LEGS]


def _add_obstacle(spec: mujoco.MjSpec, terrain: Terrain, k: int) -> None:
    """One obstacle of the terrain as a height field over its own footprint, with a pair for each foot."""
    half = np.asarray(terrain.obstacle_half_size[k]) + float(terrain.obstacle_flank[k]) / 2
    counts = np.clip(np.ceil(2 * half / GRID).astype(int) + 1, 4, MOST_POINTS)
    x, y = (np.linspace(-size, size, count) for size, count in zip(half, counts, strict=True))
    local = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    profile = np.asarray(obstacle_profile(local, terrain.obstacle_half_size[k], terrain.obstacle_flank[k]))
    name, height = f"obstacle{k}", float(terrain.obstacle_height[k])
    spec.add_hfield(
        name=name, size=[*half, height, 0.1], nrow=int(counts[1]), ncol=int(counts[0]), userdata=profile.tolist()
    )
    normal = np.asarray(terrain.normal, float)
    quaternion, turn = plane_quaternion(normal), np.zeros(4)
    place = np.zeros(3)
    centre = np.asarray(terrain.obstacle_centre[k])
    mujoco.mju_rotVecQuat(place, np.array([*centre, 0.0]), quaternion)
    mujoco.mju_axisAngle2Quat(turn, np.array([0, 0, 1.0]), float(terrain.obstacle_yaw[k]))
    mujoco.mju_mulQuat(quaternion, quaternion.copy(), turn)
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=name,
        pos=place + normal * float(terrain.offset),
        quat=quaternion,
        contype=0,
        conaffinity=0,
    )
    for leg in LEGS:
        spec.add_pair(name=f"{name}_{leg}", geomname1=name, geomname2=f"{leg}_foot", condim=3)
