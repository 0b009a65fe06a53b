"""A drive at rest."""

import jax.numpy as jnp

from sea_jax.parameters import DriveParams
from sea_jax.spring import deflection_at
from sea_jax.types import Array, DriveState


def initial_state(
    params: DriveParams, joint_position: Array, torque: Array, memory: dict[str, tuple] | None = None
) -> DriveState:
    """At rest with the spring carrying `torque` (N m); current and integrators are those that hold it. All (J,).

    `memory` is the start of the hooks' memories: {hook point: (one entry a hook, ...)}.
    """
    current = torque / (params.gear_ratio * params.torque_constant)
    current = jnp.clip(current, -params.current_limit, params.current_limit)
    return DriveState(
        motor_position=joint_position + deflection_at(params, torque),
        motor_velocity=jnp.zeros_like(joint_position),
        current=current,
        velocity_integral=jnp.clip(current, -params.velocity_integral_limit, params.velocity_integral_limit),
        current_integral=params.resistance * current,
        voltage=params.resistance * current,
        memory={} if memory is None else dict(memory),
    )
