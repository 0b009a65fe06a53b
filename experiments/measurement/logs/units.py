"""Units that a log may come in, and the factor that takes each to the SI unit of the format."""

import math
from collections.abc import Mapping
from typing import Final

from experiments.errors import UserError
from experiments.files import shown

_TURN = 2.0 * math.pi
_GRAVITY = 9.80665  # standard gravity: data sheets of accelerometers and load cells are in it

# SI unit -> {unit: factor to SI}
CONVERSIONS: Final[Mapping[str, Mapping[str, float]]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "°": math.pi / 180.0, "rev": _TURN},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6},
    "rad/s": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": math.pi / 180.0, "°/s": math.pi / 180.0}
    | {"rpm": _TURN / 60.0, "rev/s": _TURN},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/h": 1.0 / 3.6},
    "m/s^2": {"m/s^2": 1.0, "m/s²": 1.0, "mm/s^2": 1e-3, "g": _GRAVITY, "mg": _GRAVITY * 1e-3},
    "N m": {"N m": 1.0, "Nm": 1.0, "mN m": 1e-3, "mNm": 1e-3, "N cm": 1e-2, "Ncm": 1e-2}
    | {"N mm": 1e-3, "Nmm": 1e-3, "kgf cm": _GRAVITY * 1e-2},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": _GRAVITY},
    "A": {"A": 1.0, "mA": 1e-3},
    "-": {"-": 1.0, "": 1.0, "1": 1.0, "0/1": 1.0, "%": 1e-2},
}


def to_si(unit: str, si_unit: str, what: str) -> float:
    """Factor from `unit` to `si_unit`; UserError naming `what` and the units that would do."""
    factors = CONVERSIONS[si_unit]
    if unit not in factors:
        raise UserError(
            f"{what}: unit '{shown(unit)}' cannot be turned into {si_unit}; use one of {', '.join(factors)}."
        )
    return factors[unit]
