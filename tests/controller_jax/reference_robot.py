"""The robot written down anew for MuJoCo C from its numbers alone: the oracle of the controller's tests."""

import json
from importlib.resources import files

import mujoco
import numpy as np

from controller_jax.geometry import geometry_from_numbers

NUMBERS = json.loads(files("mjx_starleth").joinpath("starleth.json").read_text())
GEOMETRY = geometry_from_numbers(NUMBERS)
LIMITS = np.asarray(GEOMETRY.position_limits)
LEGS = ("LF", "RF", "LH", "RH")


def reference_model() -> mujoco.MjModel:
    """Floating robot over a floor that only its feet touch; joints of the leg order LF RF LH RH x HAA HFE KFE."""
    b = NUMBERS["bodies"]
    hip, knee, foot = (-x for x in (b["hip"]["length"], b["thigh"]["length"], b["foot"]["centre_from_knee"]))
    radius = b["foot"]["radius"]

    def inertial(name: str) -> str:
        inertia = " ".join(map(str, b[name]["inertia_diagonal"]))
        return f'<inertial pos="0 0 {b[name]["com"][2]}" mass="{b[name]["mass"]}" diaginertia="{inertia}"/>'

    legs = pairs = ""
    for leg in LEGS:
        x = b["haa_in_torso"]["x"] * (1 if leg[1] == "F" else -1)
        y = b["haa_in_torso"]["y"] * (1 if leg[0] == "L" else -1)
        legs += f"""
        <body name="{leg}_hip" pos="{x} {y} 0">{inertial("hip")}<joint axis="1 0 0"/>
        <body name="{leg}_thigh" pos="0 0 {hip}">{inertial("thigh")}<joint axis="0 1 0"/>
        <body name="{leg}_shank" pos="0 0 {knee}">{inertial("shank")}<joint axis="0 1 0"/>
        <site name="{leg}" pos="0 0 {foot}"/>
        <geom name="{leg}" type="sphere" size="{radius}" pos="0 0 {foot}" mass="0" contype="0" conaffinity="0"/>
        </body></body></body>"""
        pairs += f'<pair geom1="floor" geom2="{leg}" condim="3" friction="0.8 0.8 0.005 0.0001 0.0001"/>'
    torso = f'<body name="torso"><freejoint/>{inertial("torso")}{legs}</body>'
    floor = '<geom name="floor" type="plane" size="0 0 1" contype="0" conaffinity="0"/>'
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="0.0005" cone="elliptic" integrator="implicitfast"/>'
        f"<worldbody>{floor}{torso}</worldbody><contact>{pairs}</contact></mujoco>"
    )


def random_joints(rng: np.random.Generator) -> np.ndarray:
    """Joint positions (12,) anywhere within the limits."""
    return rng.uniform(LIMITS[:, 0], LIMITS[:, 1]).astype(np.float32)


def random_stance(rng: np.random.Generator) -> np.ndarray:
    """Feet (4, 3) in the torso frame, about under the hips, m."""
    height = rng.uniform(0.22, 0.45) + rng.normal(0, 0.03, 4)
    offset = np.stack([*rng.uniform(-0.1, 0.1, (2, 4)), -height], 1)
    return (np.asarray(GEOMETRY.r_BH_B) + offset).astype(np.float32)
