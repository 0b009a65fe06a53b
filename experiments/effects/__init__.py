"""Physical effects that a model may lack. A user's own effect file needs only `Effect` and `Parameter`."""

from experiments.effects.effect import Effect, Parameter
from experiments.effects.library import LIBRARY, find_effect, load_effects

__all__ = ["LIBRARY", "Effect", "Parameter", "find_effect", "load_effects"]
