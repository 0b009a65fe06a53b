"""Controllers that make the commands: legs in the air, squats and hops on the ground. They see the logged row.

On the ground: a virtual spring and damper on the torso, its wrench shared by the four feet with the least
forces, plus forces of the feet against each other; joint torques by the legs' Jacobians (numbers: FACTS 3.1).
"""

from dataclasses import dataclass

import numpy as np

from experiments.independent_plant import leg_geometry as leg
from experiments.independent_plant.drive import Command
from experiments.independent_plant.motions import TICK, air_course, fade, sines
from experiments.independent_plant.numbers import KINDS, MIRROR, Array, numbers_file

STAND, TAKE_OFF = 0.41, 0.455  # m, heights of the torso: where motions start, where hops leave the ground
SMOOTHING = 0.35  # of a new row in the speeds that the controller sees
RETRACT_TICKS = 24  # from the legs as they left the ground to the legs as they land
KP = np.array([600.0, 600.0, 1200.0, 300.0, 300.0, 100.0])  # N/m, N m/rad: x y z, roll pitch yaw
KD = np.array([100.0, 100.0, 150.0, 12.0, 12.0, 8.0])
SPREAD_KP, SPREAD_KD = 600.0, 10.0  # N/m, N s/m: hold the feet where they stood
LEAST_NORMAL, CONE = 4.0, 0.75  # N, share of the normal force that the controller lets a foot push sideways
AIR_KP, AIR_KD = 40.0, 1.5  # N m/rad, N m s/rad of legs in the air in torque mode
TORQUE_LIMITS = np.sort(
    MIRROR[:, None] * np.array([numbers_file()["torque_limits_LF"][kind] for kind in KINDS * 4]), axis=1
)


class AirController:
    """Position courses (B, T, 12); where `by_torque` (B, 12) a joint spring and damper in torque mode."""

    def __init__(self, courses: Array, by_torque: Array) -> None:
        self.courses, self.by_torque = courses, by_torque

    def __call__(self, k: int, row: dict[str, Array]) -> Command:
        wanted = self.courses[:, min(k, self.courses.shape[1] - 1)]
        torque = AIR_KP * (wanted - row["joint_position"]) - AIR_KD * row["joint_velocity"]
        return Command(
            np.where(self.by_torque, np.clip(torque, *TORQUE_LIMITS.T), np.nan),
            np.where(self.by_torque, np.nan, wanted),
        )


@dataclass
class TorsoCourse:
    """Where the torso should be: (T, 6) x y z [m] roll pitch yaw [rad], rates, vertical acceleration."""

    pose: Array
    rate: Array
    acceleration: Array  # (T,) m/s^2, feed-forward
    shove: Array  # (T, 2) N: the feet push each other apart along x and y
    may_fly: Array  # (T,) bool


def squat_course(duration: float, richness: str, rng: np.random.Generator) -> TorsoCourse:
    """Squats with sway, roll, pitch and yaw; `poor` is slow and small, straight up and down."""
    time = np.arange(round(duration / TICK)) * TICK
    pose, shove = np.zeros((len(time), 6)), np.zeros((len(time), 2))

    def course(size: float, low: float, high: float, count: int, top: float = np.inf) -> Array:
        shape = fade(time) * sines(time, rng, low, high, count)
        rate = np.abs(np.diff(shape)).max() / TICK
        return shape * min(size / np.abs(shape).max(), top / rate)

    if richness == "poor":
        pose[:, 2] = STAND - 0.02 + course(0.02, 0.05, 0.1, 2)
    else:
        pose[:, 2] = STAND - 0.02 + course(0.085, 0.5, 1.5, 4, top=0.7)
        for axis, size in ((0, 0.02), (1, 0.02), (3, 0.05), (4, 0.05), (5, 0.04)):
            pose[:, axis] = course(size, 0.3, 1.2, 3)
        shove = np.stack([course(15.0, 0.3, 1.5, 3), course(25.0, 0.3, 1.5, 3)], axis=1)
    pose[:, 2] += (STAND - pose[0, 2]) * (1.0 - fade(time))
    rate = np.gradient(pose, TICK, axis=0)
    return TorsoCourse(pose, rate, np.gradient(rate[:, 2], TICK), shove, np.zeros(len(time), dtype=bool))


def hop_course(duration: float, rng: np.random.Generator) -> TorsoCourse:
    """Small hops, every one a little different: crouch, push, fly, catch as the push run backwards, rise."""
    samples = round(duration / TICK)
    height = [np.full(round(0.3 / TICK), STAND)]
    fly = [np.zeros(len(height[0]), dtype=bool)]
    while sum(len(part) for part in height) * TICK + 1.6 < duration:
        speed, push = rng.uniform(0.55, 0.75), rng.uniform(3.5, 5.0)  # m/s at take-off, m/s^2
        ramp = 0.15  # of the push: the force runs down to zero before the feet leave
        time = speed / (push * (1.0 - 0.5 * ramp) - 0.5 * ramp * leg.GRAVITY)
        x = np.arange(round(time / TICK)) * TICK / time
        up = np.where(x < 1.0 - ramp, push, push - (push + leg.GRAVITY) * (x - 1.0 + ramp) / ramp)
        rise = np.cumsum(np.cumsum(up) * TICK) * TICK
        low = TAKE_OFF - rise[-1]
        flight = np.arange(round(2.0 * speed / leg.GRAVITY / TICK)) * TICK
        turn = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, round(rng.uniform(0.3, 0.45) / TICK)))
        parts = [
            STAND + (low - STAND) * turn,
            low + rise,
            TAKE_OFF + speed * flight - 0.5 * leg.GRAVITY * flight**2,
            low + rise[::-1],
            low + (STAND - low) * turn,
            np.full(round(rng.uniform(0.1, 0.3) / TICK), STAND),
        ]
        height += parts
        fly += [np.full(len(part), 2 <= i <= 3) for i, part in enumerate(parts)]
    height.append(np.full(samples, STAND))
    fly.append(np.zeros(samples, dtype=bool))
    pose = np.zeros((samples, 6))
    pose[:, 2] = np.concatenate(height)[:samples]
    rate = np.gradient(pose, TICK, axis=0)
    acceleration = np.clip(np.gradient(rate[:, 2], TICK), -leg.GRAVITY, 6.0)
    return TorsoCourse(pose, rate, acceleration, np.zeros((samples, 2)), np.concatenate(fly)[:samples])


class GroundController:
    """Follows the torso courses of a batch; in planned flight, once all feet are off, it holds the legs."""

    def __init__(self, courses: list[TorsoCourse]) -> None:
        self.pose, self.rate, self.shove, self.may_fly = (
            np.stack([getattr(course, name) for course in courses]) for name in ("pose", "rate", "shove", "may_fly")
        )
        self.acceleration = np.stack([course.acceleration for course in courses])
        self.air_ticks = np.zeros(len(courses))
        self.landing = leg.stance_angles(np.full(len(courses), TAKE_OFF - 0.01))
        self.left_at = self.landing.copy()
        self.spread = leg.feet(self.landing)[0][..., :2]
        self.smooth: dict[str, Array] = {}

    def __call__(self, k: int, row: dict[str, Array]) -> Command:
        k = min(k, self.pose.shape[1] - 1)
        for name in ("joint_velocity", "base_linear_velocity", "base_angular_velocity"):
            last = self.smooth.get(name, row[name])
            self.smooth[name] = last + SMOOTHING * (row[name] - last)
        flew, touching = self.air_ticks > 0, row["foot_contact"].sum(axis=1)
        flying = self.may_fly[:, k] & np.where(flew, touching < 2, touching == 0)
        self.air_ticks = np.where(flying, self.air_ticks + 1, 0)
        self.left_at = np.where(flew[:, None], self.left_at, row["joint_position"])
        share = np.minimum(self.air_ticks / RETRACT_TICKS, 1.0)[:, None]
        legs = self.left_at + share * (self.landing - self.left_at)
        torque = np.clip(self.stance_torque(k, row | self.smooth), *TORQUE_LIMITS.T)
        return Command(np.where(flying[:, None], np.nan, torque), np.where(flying[:, None], legs, np.nan))

    def stance_torque(self, k: int, row: dict[str, Array]) -> Array:
        """Virtual model -> foot forces -> joint torques (B, 12)."""
        angles = row["joint_position"]
        R = leg.rotation(row["base_orientation"])
        feet, jacobian = leg.feet(angles)
        foot_speed = np.einsum("blij,blj->bli", jacobian, row["joint_velocity"].reshape(-1, 4, 3))
        pose = np.concatenate([row["base_position"], leg.roll_pitch_yaw(R)], axis=1)
        omega = np.einsum("bij,bj->bi", R, row["base_angular_velocity"])
        rate = np.concatenate([row["base_linear_velocity"], omega], axis=1)
        wrench = KP * (self.pose[:, k] - pose) + KD * (self.rate[:, k] - rate)
        wrench[:, 2] += leg.TOTAL_MASS * (leg.GRAVITY + self.acceleration[:, k])
        arms = np.einsum("bij,blj->bli", R, feet)
        forces = self._shared(arms, wrench)
        forces[..., :2] += self._against_each_other(k, R, feet, foot_speed)
        forces[..., 2] = np.maximum(forces[..., 2], LEAST_NORMAL)
        sideways = np.linalg.norm(forces[..., :2], axis=-1)
        room = CONE * forces[..., 2] / np.maximum(sideways, 1e-9)
        forces[..., :2] *= np.minimum(room, 1.0)[..., None]
        torque = -np.einsum("blij,bli->blj", jacobian, np.einsum("bji,blj->bli", R, forces)).reshape(-1, 12)
        return torque + leg.weight_torque(angles, -leg.GRAVITY * R[:, 2])

    def _shared(self, arms: Array, wrench: Array) -> Array:
        """The smallest foot forces (B, 4, 3), world frame, that add up to the wrench at the torso."""
        grasp = np.zeros((len(arms), 6, 12))
        for i in range(4):
            x, y, z = arms[:, i].T
            grasp[:, :3, 3 * i : 3 * i + 3] = np.eye(3)
            grasp[:, 3, 3 * i + 1], grasp[:, 3, 3 * i + 2] = -z, y
            grasp[:, 4, 3 * i], grasp[:, 4, 3 * i + 2] = z, -x
            grasp[:, 5, 3 * i], grasp[:, 5, 3 * i + 1] = -y, x
        square = grasp @ grasp.transpose(0, 2, 1) + 1e-6 * np.eye(6)
        forces = grasp.transpose(0, 2, 1) @ np.linalg.solve(square, wrench[..., None])
        return forces.reshape(-1, 4, 3)

    def _against_each_other(self, k: int, R: Array, feet: Array, foot_speed: Array) -> Array:
        """Ground forces (B, 4, 2) on the feet that cancel over the four: shove, and hold the feet's spread."""
        outward = np.sign(self.spread)
        inner = -self.shove[:, k, None] * outward
        inner = inner + SPREAD_KP * (feet[..., :2] - self.spread) + SPREAD_KD * foot_speed[..., :2]
        inner -= inner.mean(axis=1, keepdims=True)
        return np.einsum("bij,blj->bli", R[:, :2, :2], inner)


def air_controller(
    durations: float, richness: list[str], by_torque: list[bool], rngs: list[np.random.Generator]
) -> AirController:
    """One course per log; `by_torque` puts HAA and HFE of a log in torque mode."""
    courses = np.stack([air_course(durations, r, rng) for r, rng in zip(richness, rngs)])
    hips = np.tile([True, True, False], 4)
    return AirController(courses, np.array(by_torque)[:, None] & hips)
