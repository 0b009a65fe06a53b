"""3-D playback of motions inside the report: robot, ground, contact forces, shadow, drawn by the scripts in scene/.

The page gets the points to draw (hips, knees, feet), not the joint angles: a few hundred kilobytes for a motion.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from markupsafe import Markup
from scipy.spatial.transform import Rotation

from experiments.reports.page import Page, embedded_json
from mjx_starleth.names import FORE_SIGN, LEFT_SIGN, LEGS
from mjx_starleth.numbers import RobotNumbers
from mjx_starleth.terrain import Terrain

SCRIPTS: Final = tuple(f"scene/{name}.js" for name in ("view", "paint", "robot", "ground", "timeline", "player"))
MAX_RATE: Final = 200.0  # frames per second; the page interpolates
MAX_FRAMES: Final = 1500  # 440 kB as text; longer motions get fewer frames per second


@dataclass(frozen=True, eq=False)
class Track:
    """One motion of the robot, T samples at equal steps from time 0."""

    name: str
    q: np.ndarray  # (T, 19) torso x y z, quaternion w x y z, joint positions, m and rad
    contact_force: np.ndarray  # (T, 4, 3) on the feet, world frame, N


@dataclass(frozen=True, eq=False)
class Playback:
    """A block that plays motions: the first as the robot, the second, if any, as a ghost that can be shown.

    spans: (name, start, end) of the motion's phases, s. snapshots: times of the strip of pictures below, s.
    poster: the time shown at first, s. Raises ValueError if the tracks differ in length.
    """

    tracks: Sequence[Track]
    period: float  # s between samples
    numbers: RobotNumbers
    caption: str
    spans: Sequence[tuple[str, float, float]] = ()
    snapshots: Sequence[float] = ()
    poster: float = 0.0
    terrain: Terrain | None = None  # a level plane at height 0

    def render(self, page: Page) -> Markup:
        for script in SCRIPTS:
            page.need(script)
        n = page.next_figure()
        return Markup(
            '<figure id="figure-{n}"><div class="playback" tabindex="0" aria-label="3-D playback of the motion">'
            '<script type="application/json">{data}</script></div>'
            "<figcaption><b>Figure {n}.</b> {caption}</figcaption></figure>"
        ).format(n=n, data=embedded_json(self._content()), caption=self.caption)

    def _content(self) -> dict[str, Any]:
        lengths = {len(track.q) for track in self.tracks}
        if len(lengths) != 1:
            raise ValueError("all tracks of a playback must have the same number of samples.")
        stride = max(round(1 / (MAX_RATE * self.period)), -(-lengths.pop() // MAX_FRAMES), 1)
        bodies = self.numbers.bodies
        hip = bodies.haa_in_torso
        tracks = [
            {"name": track.name, "frames": _base64(frames(track, self.numbers)[::stride])} for track in self.tracks
        ]
        return {
            "period": self.period * stride,
            "tracks": tracks,
            "columns": 55,
            "box": bodies.torso.box,
            "hips": [(f * hip.x, s * hip.y, hip.z) for f, s in zip(FORE_SIGN, LEFT_SIGN, strict=True)],
            "footRadius": bodies.foot.radius,
            "friction": self.numbers.contact.friction,
            "contactForce": self.numbers.contact.contact_flag_force,
            "legs": LEGS,
            "spans": list(self.spans),
            "snapshots": [float(t) for t in self.snapshots],
            "poster": self.poster,
            "ground": _ground(self.terrain),
        }


def leg_points(q: np.ndarray, numbers: RobotNumbers) -> np.ndarray:
    """World positions of HFE axis, knee and foot centre, (T, 4, 3, 3), from coordinates (T, 19)."""
    b = numbers.bodies
    rotation = Rotation.from_quat(q[:, 3:7], scalar_first=True).as_matrix()
    angle = q[:, 7:].reshape(-1, 4, 3)
    hip = np.array([(f * b.haa_in_torso.x, s * b.haa_in_torso.y, b.haa_in_torso.z) for f, s in _SIDES])

    def below(pitch: np.ndarray, length: float) -> np.ndarray:
        """A link's vector in the torso frame: down -z, turned by `pitch` about y, then by HAA about x."""
        x, z = -length * np.sin(pitch), -length * np.cos(pitch)
        haa = angle[..., 0]
        return np.stack([x, -z * np.sin(haa), z * np.cos(haa)], -1)

    hfe = hip + below(np.zeros_like(angle[..., 0]), b.hip.length)
    knee = hfe + below(angle[..., 1], b.thigh.length)
    foot = knee + below(angle[..., 1] + angle[..., 2], b.foot.centre_from_knee)
    points = np.stack([hfe, knee, foot], 2)
    return q[:, None, None, :3] + np.einsum("tij,tlkj->tlki", rotation, points)


def frames(track: Track, numbers: RobotNumbers) -> np.ndarray:
    """(T, 55) float32: torso position 3, quaternion 4, HFE, knee and foot of each leg 36, contact forces 12.

    The quaternions' signs are chosen so that neighbours can be interpolated.
    """
    q = np.array(track.q, np.float64)
    turned = np.einsum("ti,ti->t", q[1:, 3:7], q[:-1, 3:7]) < 0
    q[1:, 3:7] *= np.where(np.cumsum(turned) % 2, -1.0, 1.0)[:, None]
    parts = [q[:, :7], leg_points(q, numbers).reshape(len(q), 36), np.reshape(track.contact_force, (len(q), 12))]
    return np.concatenate(parts, 1).astype("<f4")


_SIDES: Final = tuple(zip(FORE_SIGN, LEFT_SIGN, strict=True))


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def _ground(terrain: Terrain | None) -> dict[str, Any]:
    if terrain is None:
        return {"normal": [0, 0, 1], "offset": 0, "obstacles": [], "patches": []}
    as_list = {name: np.asarray(value, np.float64).tolist() for name, value in terrain._asdict().items()}
    obstacle = ("centre", "half_size", "yaw", "height", "flank")
    columns = [as_list[f"obstacle_{name}"] for name in obstacle]
    return {
        "normal": as_list["normal"],
        "offset": as_list["offset"],
        "obstacles": [dict(zip(obstacle, row, strict=True)) for row in zip(*columns, strict=True) if row[3]],
        "patches": [
            {"centre": centre, "halfSize": half, "friction": friction}
            for centre, half, friction in zip(
                as_list["patch_centre"], as_list["patch_half_size"], as_list["patch_friction"], strict=True
            )
        ],
    }
