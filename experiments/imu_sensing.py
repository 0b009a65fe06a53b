"""The robot's own senses: IMU and joint encoders, from which the extended Kalman filter estimates the torso (III.A)."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from controller_jax import state_estimator
from controller_jax.geometry import geometry_from_numbers
from controller_jax.state_estimator import EstimatorParams, EstimatorState, SensorReading
from controller_jax.types import LegGeometry, RobotState
from experiments.known_numbers import known_numbers
from experiments.model import Model
from experiments.plant import PlantState
from experiments.sensing import NOISE, DirectSensing, Sensing, contact_flags, noisy_joints, rotation_matrix
from sea_jax import JointMeasurement

Array = jax.Array


class ImuFaults(NamedTuple):
    """What is wrong with the IMU beside white noise: constant biases that the filter has to find."""

    gyro_bias: tuple[float, float, float] = (0.005, -0.005, 0.003)  # rad/s
    accelerometer_bias: tuple[float, float, float] = (0.05, -0.05, 0.05)  # m/s^2
    gyro_noise: float = NOISE.base_angular_velocity  # rad/s
    accelerometer_noise: float = 0.1  # m/s^2


# A standing foot is less certain than its joint sensors: it rolls, and it slips a little before it is found out.
FILTER = EstimatorParams(
    gyro=0.01,
    accelerometer=0.5,
    gyro_bias_walk=1e-3,
    accelerometer_bias_walk=5e-3,
    foot_velocity=0.1,
    outlier=20.0,
    initial=(0.01, 0.05, 0.01, 0.1),
)


class ImuState(NamedTuple):
    """What the scan carries."""

    filter: EstimatorState
    v_WB: Array  # (3,) true velocity at the last tick, of which the accelerometer shows the change, m/s


@dataclass(frozen=True, eq=False)
class EstimatedSensing:
    """Stands in for DirectSensing: the locomotion controller sees only what the robot itself can know."""

    geometry: LegGeometry
    period: float
    gravity: float
    params: EstimatorParams
    contact_force: float  # N from which a foot counts as on the ground
    faults: ImuFaults = field(default_factory=ImuFaults)

    def start(self, plant: PlantState) -> ImuState:
        """The filter starts from the true pose at rest, with its initial uncertainty."""
        q, u = plant.bodies.q, plant.bodies.u
        return ImuState(state_estimator.init(self.params, q[:3], rotation_matrix(q[3:7]), u[:3]), u[:3])

    def step(
        self, state: ImuState, plant: PlantState, measurement: JointMeasurement, noise: Array
    ) -> tuple[ImuState, RobotState, JointMeasurement]:
        measurement = noisy_joints(measurement, noise)
        q, u = plant.bodies.q, plant.bodies.u
        up = jnp.array([0.0, 0.0, self.gravity], jnp.float32)
        acceleration = (u[:3] - state.v_WB) / self.period + up
        force_B = (rotation_matrix(q[3:7]) * acceleration[:, None]).sum(0)
        faults = self.faults
        reading = SensorReading(
            gyro_B=u[3:6] + _vector(faults.gyro_bias) + faults.gyro_noise * noise[57:60],
            specific_force_B=force_B + _vector(faults.accelerometer_bias) + faults.accelerometer_noise * noise[54:57],
            q=measurement.position,
            qd=measurement.velocity,
            contact=contact_flags(plant.contact_force, self.contact_force),
        )
        estimate, robot, _ = state_estimator.step(
            self.params, self.geometry, state.filter, reading, jnp.float32(self.period)
        )
        # without the barrier XLA computes parts of the filter again for each of their many uses in the controller
        estimate, robot = jax.lax.optimization_barrier((estimate, robot))
        return ImuState(estimate, u[:3]), robot, measurement


def estimated_sensing(model: Model) -> EstimatedSensing:
    """IMU, encoders and filter of a robot."""
    numbers = known_numbers(model)
    params = EstimatorParams(*(jnp.asarray(value, jnp.float32) for value in FILTER))
    return EstimatedSensing(
        geometry_from_numbers(numbers),
        numbers["loops"]["control_period"],
        numbers["gravity"],
        params,
        numbers["contact"]["contact_flag_force"],
    )


def make_sensing(name: Literal["direct", "estimated"], model: Model) -> Sensing:
    """How a stage of a task's search sees the robot, by name."""
    if name == "estimated":
        return estimated_sensing(model)
    return DirectSensing(model.numbers.contact.contact_flag_force)


def _vector(values: tuple[float, float, float]) -> np.ndarray:
    return np.asarray(values, np.float32)
