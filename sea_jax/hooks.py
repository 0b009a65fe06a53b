"""Splicing user functions into the drive's equations.

A hook is `(value, signals, memory) -> (value, memory)`. Its memory lives in `DriveState.memory`, a dict from
the hook point's name to one entry a hook; a point that is absent there has hooks without memory (they get and
return None). Without hooks nothing is computed and nothing is carried.
"""

from typing import Any

import jax.numpy as jnp

from sea_jax.types import Array, DriveHooks, JointMotion, Signals


def apply_hooks(
    hooks: DriveHooks, point: str, value: Any, signals: Signals, memory: dict[str, tuple]
) -> tuple[Any, dict[str, tuple]]:
    """Passes value through the hooks of one point in order; returns it with the memory after.

    Raises ValueError where memories and hooks do not pair up, or a hook without memory returns one.
    """
    chain = getattr(hooks, point)
    if not chain:
        return value, memory
    before = memory.get(point, (None,) * len(chain))
    if len(before) != len(chain):
        raise ValueError(f"{len(chain)} hooks at '{point}' need as many memories, the state has {len(before)}")
    after = []
    for hook, old in zip(chain, before, strict=True):
        value, new = hook(value, signals, old)
        after.append(new)
    if point in memory:
        return value, memory | {point: tuple(after)}
    if any(new is not None for new in after):
        raise ValueError(f"a hook at '{point}' returned a memory that the state does not carry: give it its start")
    return value, memory


def no_signals(like: Array, period: float) -> Signals:
    """Signals for the points where none exists yet."""
    nothing = jnp.zeros_like(like)
    return Signals(*(nothing,) * 10, period=jnp.asarray(period, like.dtype))


def link_signals(motion: JointMotion, period: float) -> Signals:
    """Signals for the points where nothing is known but the links' motion, (J,)."""
    nothing = no_signals(motion.position, period)
    return nothing._replace(joint_position=motion.position, joint_velocity=motion.velocity)
