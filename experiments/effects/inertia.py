"""Masses that the nominal numbers lack: a payload on the torso, links that are heavier, a constant pull."""

from math import cos, pi, sin

import jax
import jax.numpy as jnp

from experiments.effects.effect import Effect, Parameter
from mjx_starleth.body_types import BodyParams

Array = jax.Array

ASIDE = tuple(k * pi / 4 for k in range(8))  # rad from forwards
OFF_CENTRE = 0.15  # m from the torso's origin at which a load is looked for on each side, most of half its width


def _payload(p, bodies, _):
    # a point mass on the torso: new centre of mass, and both masses' parallel axes about it (diagonal kept)
    place = jnp.stack([p.x, p.y, p.z])
    torso, com = bodies.mass[0], bodies.com[0]
    total = torso + p.mass
    centre = (torso * com + p.mass * place) / total
    added = torso * _about(com - centre) + p.mass * _about(place - centre)
    return bodies._replace(
        mass=_with_torso(bodies.mass, total),
        com=_with_torso(bodies.com, centre),
        inertia=_with_torso(bodies.inertia, bodies.inertia[0] + added),
    )


def _about(r):
    """Diagonal of the inertia (3,) of a unit mass at r (3,)."""
    square = r * r
    return square.sum() - square


def _with_torso(values, torso):
    return jnp.concatenate([jnp.reshape(torso, (1, *values.shape[1:])), values[1:]])


def scaled(bodies: BodyParams, factor: Array) -> BodyParams:
    """Bodies of other density: each mass and inertia `factor` (13,) times as large."""
    return bodies._replace(mass=bodies.mass * factor, inertia=bodies.inertia * factor[:, None])


def _link_mass(p, bodies, _):
    return scaled(bodies, jnp.concatenate([jnp.ones(1, jnp.float32), 1.0 + p.relative]))


def _link_com(p, bodies, _):
    return bodies._replace(com=bodies.com * jnp.concatenate([jnp.ones(1, jnp.float32), 1.0 + p.relative])[:, None])


def _force(p, force, _):
    return force + jnp.stack([p.x, p.y, p.z])


# A nominal number that may be a little off, and is never told apart from a link's mass well enough to be accused.
LINK_COM = Effect(
    "link_com",
    "a link's centre of mass is further from or nearer to its joint than nominal",
    "bodies",
    "link",
    (Parameter("relative", "1", -0.9, 2.0, 0.1),),
    {"body_parameters": _link_com},
)
EFFECTS = (
    Effect(
        "payload",
        "the torso carries a mass that the model does not know of",
        "bodies",
        "torso",
        (
            Parameter("mass", "kg", -8.0, 30.0, 2.0),
            Parameter("x", "m", -0.4, 0.4, 0.0, "shape"),
            Parameter("y", "m", -0.3, 0.3, 0.0, "shape"),
            Parameter("z", "m", -0.3, 0.4, 0.0, "shape"),
        ),
        {"body_parameters": _payload},
        # a torso that may be a little heavier hides what a load weighs, but not on which side it is
        seeds=tuple({"x": round(OFF_CENTRE * cos(a), 3), "y": round(OFF_CENTRE * sin(a), 3)} for a in ASIDE),
    ),
    Effect(
        "link_mass",
        "a link is heavier or lighter than nominal",
        "bodies",
        "link",
        (Parameter("relative", "1", -0.9, 10.0, 0.3),),
        {"body_parameters": _link_mass},
    ),
    Effect(
        "constant_force",
        "something pulls or pushes the torso all the time, in a direction fixed in the world",
        "bodies",
        "torso",
        (
            Parameter("x", "N", -200.0, 200.0, 5.0),
            Parameter("y", "N", -200.0, 200.0, 5.0),
            Parameter("z", "N", -200.0, 200.0, 5.0),
        ),
        {"torso_force": _force},
    ),
    LINK_COM,
)
