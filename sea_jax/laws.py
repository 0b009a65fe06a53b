"""The laws of a drive that have corners. A drive takes them as an argument, so that rounded ones can stand in."""

from collections.abc import Callable
from typing import NamedTuple

from sea_jax.electronics import current_at_once
from sea_jax.friction import stick_or_slip
from sea_jax.joint_controllers import limited_velocity, wanted_velocity
from sea_jax.spring import spring_coefficients
from sea_jax.velocity_loop import velocity_loop


class DriveLaws(NamedTuple):
    """Functions with the signatures of their defaults, the laws as they are."""

    wanted_velocity: Callable = wanted_velocity
    limited_velocity: Callable = limited_velocity
    velocity_loop: Callable = velocity_loop
    current_at_once: Callable = current_at_once  # of the cheap drive
    spring_coefficients: Callable = spring_coefficients
    stick_or_slip: Callable = stick_or_slip


LAWS = DriveLaws()
