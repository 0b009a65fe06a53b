"""What a controller knows of its robot: the nominal numbers, with the masses that its model has learned."""

from typing import Any

import numpy as np

from experiments.effects.compose import activate
from experiments.effects.library import LIBRARY
from experiments.model import Model
from mjx_starleth.body_types import nominal_params

MASSES = ("payload", "link_mass")


def known_numbers(model: Model) -> dict[str, Any]:
    """The robot's numbers as JSON values, torso and links as heavy as the model has them.

    A load that was measured is held against gravity, and stiffness and damping count on it; all other effects of a
    model stay unknown to the controller. Its legs share their numbers: their links have the mean of the four.
    """
    numbers = model.numbers.model_dump(mode="json")
    effects, values, _ = activate([placed for placed in model.effects if placed.effect in MASSES], LIBRARY)
    if not effects.effects:
        return numbers
    bodies = effects.apply("body_parameters", values, nominal_params(model.numbers))
    mass, com = np.asarray(bodies.mass, float), np.asarray(bodies.com, float)
    numbers["bodies"]["torso"] |= {"mass": mass[0], "com": com[0].tolist()}
    for name, of_legs in zip(("hip", "thigh", "shank"), mass[1:].reshape(4, 3).mean(0), strict=True):
        numbers["bodies"][name]["mass"] = of_legs
    return numbers
