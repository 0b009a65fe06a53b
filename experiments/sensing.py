"""From the plant to what the controllers see: perfect, or with the noise that the robot's logs show."""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from controller_jax.types import RobotState
from experiments.plant import PlantState
from mjx_starleth.rotation import rotation_matrix
from sea_jax import JointMeasurement

Array = jax.Array


class Noise(NamedTuple):
    """Standard deviations of the robot's sensors, as in its logs (LOGS)."""

    joint_position: float = 2e-4  # rad
    joint_velocity: float = 0.02  # rad/s
    motor_position: float = 5e-5  # rad
    joint_torque: float = 0.05  # N m
    base_position: float = 5e-4  # m
    base_orientation: float = 5e-4  # rad
    base_linear_velocity: float = 0.01  # m/s
    base_angular_velocity: float = 0.005  # rad/s


NOISE = Noise()


class Sensing(Protocol):
    """How the state reaches the controllers."""

    def start(self, plant: PlantState) -> Any:
        """State of the estimator before the first tick."""

    def step(
        self, state: Any, plant: PlantState, measurement: JointMeasurement, noise: Array
    ) -> tuple[Any, RobotState, JointMeasurement]:
        """(estimator state, state as the locomotion controller sees it, what the joint controllers see)."""


@dataclass(frozen=True, eq=False)
class DirectSensing:
    """Torso pose and velocity as measured from outside, joints from their encoders."""

    contact_force: float  # N from which a foot counts as on the ground

    def start(self, plant: PlantState) -> tuple[()]:
        return ()

    def step(
        self, state: tuple[()], plant: PlantState, measurement: JointMeasurement, noise: Array
    ) -> tuple[tuple[()], RobotState, JointMeasurement]:
        measurement = noisy_joints(measurement, noise)
        q, u = plant.bodies.q, plant.bodies.u
        R_WB = rotation_matrix(q[3:7])
        tilt = NOISE.base_orientation * noise[51:54]
        robot = RobotState(
            r_WB=q[:3] + NOISE.base_position * noise[48:51],
            R_WB=R_WB + _times_skew(R_WB, tilt),
            v_WB=u[:3] + NOISE.base_linear_velocity * noise[54:57],
            omega_B=u[3:6] + NOISE.base_angular_velocity * noise[57:60],
            q=measurement.position,
            qd=measurement.velocity,
            contact=contact_flags(plant.contact_force, self.contact_force),
        )
        return state, robot, measurement


def noisy_joints(measurement: JointMeasurement, noise: Array) -> JointMeasurement:
    """Joint sensors with noise (first 48 columns of a noise row)."""
    return JointMeasurement(
        measurement.position + NOISE.joint_position * noise[:12],
        measurement.velocity + NOISE.joint_velocity * noise[12:24],
        measurement.torque + NOISE.joint_torque * noise[24:36],
        measurement.motor_position + NOISE.motor_position * noise[36:48],
    )


def contact_flags(force: Array, least: float) -> Array:
    """1.0 for each foot (4,) on which a force (4, 3) of at least so many N acts."""
    return ((force * force).sum(-1) >= least**2).astype(jnp.float32)


def _times_skew(R: Array, v: Array) -> Array:
    """R [v]x, so that R + R [v]x is R turned by the small angle v in its own frame; (3, 3)."""
    return jnp.cross(R, v[None, :])
