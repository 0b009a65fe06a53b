"""Locomotion control (paper III, V): legs, virtual model, force distribution, the squat jump, gaits, state estimation.

`squat_jump`, `locomotion` and `state_estimator` are modules with `init(...) -> state` and `step(...)`; everything sees
one robot, is pure, and runs under vmap.
"""

from controller_jax import locomotion, squat_jump, state_estimator
from controller_jax.force_distribution import (
    DistributionState,
    ForceDistribution,
    distribute_forces,
    init_distribution,
)
from controller_jax.force_problem import DistributionSettings, SupportLegs
from controller_jax.geometry import geometry_from_numbers
from controller_jax.joint_torques import joint_torques, weight_torque
from controller_jax.leg_kinematics import LegKinematics, inverse_kinematics, leg_kinematics
from controller_jax.locomotion import GaitParams
from controller_jax.squat_jump_settings import SquatJumpParams, SquatJumpSettings
from controller_jax.state_estimator import EstimatorParams, SensorReading
from controller_jax.types import JointTargets, LegGeometry, RobotState
from controller_jax.velocity_command import VelocityCommand
from controller_jax.virtual_model import Gains, IntegralLimits, init_integrals, virtual_model

__all__ = [
    "DistributionSettings",
    "DistributionState",
    "EstimatorParams",
    "ForceDistribution",
    "Gains",
    "GaitParams",
    "IntegralLimits",
    "JointTargets",
    "LegGeometry",
    "LegKinematics",
    "RobotState",
    "SensorReading",
    "SquatJumpParams",
    "SquatJumpSettings",
    "SupportLegs",
    "VelocityCommand",
    "distribute_forces",
    "geometry_from_numbers",
    "init_distribution",
    "init_integrals",
    "inverse_kinematics",
    "joint_torques",
    "leg_kinematics",
    "locomotion",
    "squat_jump",
    "state_estimator",
    "virtual_model",
    "weight_torque",
]
