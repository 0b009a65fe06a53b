"""Numbers of the squat jump (V.C.2): the 13 that are searched, and what is fixed."""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.force_problem import DistributionSettings
from controller_jax.types import Array, LegGeometry
from controller_jax.virtual_model import Gains, IntegralLimits


class SquatJumpParams(NamedTuple):
    """The 13 numbers of V.C.2."""

    height_knots: Array  # (8,) torso above ground, evenly over the launch, m
    foot_knots: Array  # (3,) foot below its hip, evenly over the flight, m
    initial_height: Array  # () torso above ground in the crouch, m
    vertical_damping: Array  # () of the virtual model in the launch, N s/m


class SquatJumpSettings(NamedTuple):
    """What is not searched."""

    geometry: LegGeometry
    launch_gains: Gains  # the vertical damping comes from the parameters
    landing_gains: Gains
    integral_limits: IntegralLimits
    distribution: DistributionSettings
    crouch_time: Array  # () s
    launch_time: Array  # () s, length of the height spline
    landing_height: Array  # () torso above ground when standing again, m
    lowest_height: Array  # () torso above ground, that the landing may use up, m
    deceleration: Array  # () least of the landing, m/s^2
    rise_time: Array  # () s from the lowest point to standing
    control_period: Array  # () s


def default_settings(geometry: LegGeometry, control_period: float = 2.5e-3) -> SquatJumpSettings:
    """Settings from FACTS 3.1, 3.2 and 3.5; landing gains tuned in simulation for a landing without rebound."""

    def vector(*values: float) -> Array:
        return jnp.asarray(values, jnp.float32)

    def gains(vertical_p: float, vertical_i: float, vertical_d: float, mass: Array) -> Gains:
        return Gains(
            force_p=vector(500.0, 640.0, vertical_p),
            force_i=vector(250.0, 320.0, vertical_i),
            force_d=vector(150.0, 100.0, vertical_d),
            torque_p=vector(400.0, 200.0, 0.0),
            torque_i=vector(200.0, 100.0, 0.0),
            torque_d=vector(6.0, 9.0, 50.0),
            mass=mass,
            inertia=vector(0.0, 0.0, 0.0),
        )

    return SquatJumpSettings(
        geometry=geometry,
        launch_gains=gains(600.0, 600.0, 120.0, geometry.torso_mass),
        landing_gains=gains(300.0, 300.0, 350.0, geometry.torso_mass + 4.0 * geometry.link_mass.sum()),
        integral_limits=IntegralLimits(jnp.float32(30.0), jnp.float32(10.0)),
        distribution=DistributionSettings(
            wrench_weight=vector(1.0, 1.0, 1.0, 20.0, 20.0, 5.0),
            regularizer=jnp.float32(1e-5),
            # a corner of the pyramid lies root two further out than its sides: 0.6 keeps it near the ground's 0.8
            friction=jnp.float32(0.6),
            minimal_normal=jnp.float32(2.0),
            torque_limits=geometry.torque_limits,
        ),
        crouch_time=jnp.float32(0.3),
        launch_time=jnp.float32(0.4),
        landing_height=jnp.float32(0.42),
        lowest_height=jnp.float32(0.28),
        deceleration=jnp.float32(20.0),
        rise_time=jnp.float32(0.55),
        control_period=jnp.float32(control_period),
    )
