"""Named parameter space: what a search may change, in which unit, between which bounds.

A search works in normalised coordinates y = (x - low) / scale, where x is the vector in the parameters' own units.
With the default scale, the range high - low, the box is [0, 1]^n and a standard deviation of 0.25 is a quarter of the
range. A smaller scale makes the search step more finely in that parameter and its box longer than 1.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

LARGEST = 1e30  # of any bound: float32 holds it, and a range made of two of them


@dataclass(frozen=True)
class Parameter:
    """One number to be searched. low, high, initial and scale are in `unit`; scale None means the range.

    Raises ValueError (one sentence) if a bound or the initial guess makes no sense.
    """

    name: str
    unit: str
    low: float
    high: float
    initial: float
    scale: float | None = None

    def __post_init__(self) -> None:
        for field in ("low", "high", "initial", "scale"):
            value = getattr(self, field)
            if value is None and field == "scale":
                value = self.high - self.low
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise ValueError(f"parameter '{self.name}': {field} must be a finite number, not {value!r}")
            if abs(value) > LARGEST:
                raise ValueError(
                    f"parameter '{self.name}': {field} = {value:g} is too large; keep it below {LARGEST:g}"
                )
            object.__setattr__(self, field, float(value))
        # a range that float32 cannot resolve would silently be a single value in the rollout
        if not np.float32(self.low) < np.float32(self.high):
            raise ValueError(f"parameter '{self.name}': low {self.low:g} must be below high {self.high:g}")
        if not self.scale > 0:
            raise ValueError(f"parameter '{self.name}': scale must be positive, not {self.scale:g}")
        self.check(self.initial, "initial guess")

    def check(self, value: float, what: str = "value") -> None:
        """Raise ValueError, naming the bound, if `value` is not a number within the bounds (to float32 rounding)."""
        if not math.isfinite(value):
            raise ValueError(f"parameter '{self.name}': {what} must be a finite number, not {value!r}")
        if np.float32(value) < np.float32(self.low):
            bound = f"below its low bound {self.low:g}"
        elif np.float32(value) > np.float32(self.high):
            bound = f"above its high bound {self.high:g}"
        else:
            return
        raise ValueError(f"parameter '{self.name}': {what} {value:g} is {bound} {self.unit}".rstrip())


@dataclass(frozen=True)
class ParameterSpace:
    """Ordered, named parameters and their view as a float32 vector (n,). Hashable, so it can be a static argument."""

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        if not self.parameters:
            raise ValueError("a parameter space needs at least one parameter")
        for name in self.names:
            if self.names.count(name) > 1:
                raise ValueError(f"the parameter name '{name}' is used {self.names.count(name)} times")

    @property
    def size(self) -> int:
        """Number of parameters n."""
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of the vector."""
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def low(self) -> np.ndarray:
        """(n,) lower bounds in the parameters' units, float64."""
        return np.array([parameter.low for parameter in self.parameters])

    @cached_property
    def high(self) -> np.ndarray:
        """(n,) upper bounds in the parameters' units, float64."""
        return np.array([parameter.high for parameter in self.parameters])

    @cached_property
    def scale(self) -> np.ndarray:
        """(n,) length of one normalised unit in the parameters' units, float64."""
        return np.array([parameter.scale for parameter in self.parameters])

    @cached_property
    def initial(self) -> np.ndarray:
        """(n,) initial guess in the parameters' units, float32."""
        return np.array([parameter.initial for parameter in self.parameters], np.float32)

    @cached_property
    def normalised_high(self) -> np.ndarray:
        """(n,) upper corner of the normalised box, float32; the lower corner is the origin."""
        return ((self.high - self.low) / self.scale).astype(np.float32)

    def normalise(self, vector: np.ndarray) -> np.ndarray:
        """(..., n) in the parameters' units to (..., n) normalised, float32."""
        return ((np.asarray(vector, np.float64) - self.low) / self.scale).astype(np.float32)

    def denormalise(self, normalised: np.ndarray) -> np.ndarray:
        """(..., n) normalised to (..., n) in the parameters' units, float32, rounding kept within the bounds."""
        vector = self.low + self.scale * np.asarray(normalised, np.float64)
        return np.clip(vector, self.low, self.high).astype(np.float32)

    def vector(self, values: Mapping[str, float]) -> np.ndarray:
        """Named values to the vector (n,); ValueError naming what is missing, unknown or out of bounds."""
        for name in values:
            if name not in self.names:
                raise ValueError(f"unknown parameter '{name}'; this space has {', '.join(self.names)}")
        for parameter in self.parameters:
            if parameter.name not in values:
                raise ValueError(f"parameter '{parameter.name}' is missing")
            parameter.check(values[parameter.name])
        return np.array([values[name] for name in self.names], np.float32)

    def named(self, vector: np.ndarray) -> dict[str, float]:
        """Vector (n,) to named values, inside the float64 bounds; ValueError naming what is out of bounds.

        float32(0.55) is above 0.55: the clip undoes that, and rounding to float32 again gives the same vector.
        """
        vector = np.asarray(vector)
        if vector.shape != (self.size,):
            raise ValueError(f"expected a vector of {self.size} parameters, not an array of shape {vector.shape}")
        for parameter, value in zip(self.parameters, vector, strict=True):
            parameter.check(float(value))
        clipped = np.clip(vector.astype(np.float64), self.low, self.high)
        return dict(zip(self.names, clipped.tolist(), strict=True))

    def describe(self) -> dict[str, Any]:
        """Everything that defines the space as plain JSON values, by name and in order."""
        return {parameter.name: asdict(parameter) for parameter in self.parameters}
