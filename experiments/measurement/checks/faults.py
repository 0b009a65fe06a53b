"""A data fault: what is wrong with a log itself, named before anybody takes it for physics."""

from dataclasses import dataclass
from typing import Final, Literal

from experiments.measurement.logs.log import SIGNALS, XYZ
from mjx_starleth.names import LEGS

FaultKind = Literal[
    "empty_log",
    "time",
    "dropped_samples",
    "repeated_samples",
    "no_value",
    "joint_never_moves",
    "dead_sensor",
    "stuck_sensor",
    "clipped_sensor",
    "spike",
    "copied_column",
    "noise_std",
    "experiment",
    "quaternion",
    "contact",
    "sign",
    "unit",
    "time_shift",
    "swapped_joints",
    "swapped_axes",
    "unrelated",
]

_KINDS: Final = {"legs": LEGS, "axes": XYZ, "components": SIGNALS["base_orientation"].names}


@dataclass(frozen=True)
class Fault:
    """One fault: its kind, the joints, legs or axes concerned in words, and one sentence with what to do about it."""

    fault: FaultKind
    where: str
    message: str


def listed(names: tuple[str, ...], everything: tuple[str, ...] = ()) -> str:
    """'LF_HAA', 'LF_HAA and RF_HAA', or 'all joints' (legs, axes, components) where these are all of `everything`."""
    if set(names) == set(everything) and len(names) > 1:
        return next((f"all {kind}" for kind, its in _KINDS.items() if set(its) == set(names)), "all joints")
    if len(names) > 6:
        return f"{len(names)} joints ({', '.join(names[:4])}, …)"
    return " and ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} and {names[-1]}"


def counted(number: int, noun: str) -> str:
    """'1 place', '2 places'."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
