"""The ground is not the level, rigid, 0.8 ground of the nominal model."""

from typing import Any

import jax.numpy as jnp

from experiments.effects.effect import Effect, Parameter
from mjx_starleth.body_types import BodyParams


def _friction(p, bodies, _):
    return bodies._replace(friction=bodies.friction * (1.0 + p.relative))


def _compliance(p, bodies, _):
    damping = jnp.where(p.compliance > 0, p.damping, 0.0)
    return bodies._replace(compliance=bodies.compliance + p.compliance, ground_damping=bodies.ground_damping + damping)


def tilt(p: Any, bodies: BodyParams, _: Any = None) -> BodyParams:
    """A ground that rises by p.x per metre along the world's x axis, by p.y along y."""
    normal = bodies.terrain.normal - bodies.terrain.normal[2] * jnp.stack([p.x, p.y, jnp.zeros_like(p.x)])
    normal = normal / jnp.sqrt((normal * normal).sum())
    return bodies._replace(terrain=bodies.terrain._replace(normal=normal))


EFFECTS = (
    Effect(
        "ground_friction",
        "the ground is more or less slippery than nominal",
        "contact",
        "foot",
        (Parameter("relative", "1", -0.95, 1.5, -0.3),),
        {"body_parameters": _friction},
    ),
    Effect(
        "ground_compliance",
        "the ground gives way under load, a spring and a damper below each foot",
        "contact",
        "foot",
        (
            Parameter("compliance", "m/N", 0.0, 1e-3, 2e-5),
            Parameter("damping", "N s/m", 0.0, 2000.0, 100.0, "shape"),
        ),
        {"body_parameters": _compliance},
    ),
    Effect(
        "ground_slope",
        "the ground is tilted",
        "contact",
        "ground",
        (Parameter("x", "m/m", -0.6, 0.6, 0.05), Parameter("y", "m/m", -0.6, 0.6, 0.05)),
        {"body_parameters": tilt},
    ),
)
