"""How strong a hidden effect is: RMS of its torque over the RMS commanded torque of the joints where it acts.

The commanded torque is the joint's in torque mode and what the velocity loop asks of the motor in position mode.
What is no torque counts as one in this way:
  encoder offset and eccentricity, delays   the nominal spring's torque for the error of the angle (or the torque)
  link mass                                 inverse dynamics with and without it
  payload, forces, slope                    the force over the robot's weight
  ground friction and compliance, delay of  the change of the joint torques against the same run without it
  the base's sensors
"""

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from experiments.independent_plant.leg_geometry import GRAVITY, TOTAL_MASS
from experiments.independent_plant.library import Effect
from experiments.independent_plant.numbers import KINDS, Array, joints_at
from experiments.independent_plant.plant import Recording

LEVELS = (0.05, 0.1, 0.2, 0.4)
TABLE = Path(__file__).with_name("strengths.json")
BEYOND = 2.0  # factor by which a parameter may leave the table
BY_TWIN = ("ground_friction", "ground_compliance")  # and sensor_delay at the torso


def by_weight(effect: Effect) -> float | None:
    """Strength of what acts on the whole robot, None for other effects."""
    values = effect.family.checked(effect.parameters)
    weight = TOTAL_MASS * GRAVITY
    if effect.effect in ("payload", "sloshing"):
        return values["mass"] / TOTAL_MASS
    if effect.effect == "constant_force":
        return float(np.linalg.norm([values["x"], values["y"], values["z"]])) / weight
    if effect.effect == "wind":
        return float(np.sqrt(3.0)) * values["force_rms"] / weight
    if effect.effect == "ground_slope":
        return float(np.hypot(np.sin(values["x"]), np.sin(values["y"])))
    return None


def needs_twin(effect: Effect) -> bool:
    """Whether only a run without the effect tells its strength."""
    return effect.effect in BY_TWIN or (effect.effect == "sensor_delay" and effect.where == "torso")


def strength(effect: Effect, recording: Recording, log: int, twin: dict[str, Array] | None = None) -> float:
    """Strength of one effect in one recorded log. `twin`: the true signals (T, n) of the same run without it, which
    some effects need; NaN without."""
    whole = by_weight(effect)
    if whole is not None:
        return whole
    joints = np.ones(12, dtype=bool) if effect.where in ("torso", "feet") else joints_at(effect.where) > 0.0
    commanded = recording.command_power[log, joints].sum()
    if needs_twin(effect):
        if twin is None:
            return float("nan")
        changed = recording.true["joint_torque"][log] - twin["joint_torque"]
        return float(np.sqrt(np.square(changed[:, joints]).sum() / commanded))
    return float(np.sqrt(recording.power[effect.effect][log, joints].sum() / commanded))


@cache
def table() -> dict[str, dict[str, dict[str, list[list[float]]]]]:
    """Motion -> effect -> joint kind or `robot` -> pairs of (parameter, strength), made by calibrate.py."""
    return json.loads(TABLE.read_text()) if TABLE.exists() else {}


def reachable(motion: str, effect: str) -> bool:
    """Whether the table knows the effect in this motion."""
    return effect in table().get(motion, {})


def live_kinds(motion: str, effect: str) -> list[str]:
    """The joint kinds (or `robot`) at which the effect does something in the motion."""
    return list(table()[motion][effect])


def span(motion: str, effect: str) -> tuple[float, float]:
    """Least and greatest strength in the table."""
    found = [pair[1] for pairs in table()[motion][effect].values() for pair in pairs]
    return min(found), max(found)


def parameter_for(motion: str, effect: str, where: str, wanted: float) -> float:
    """The scaled parameter that gives about the wanted strength (log-log, straight a little beyond the table's ends).

    Where a joint cannot show an effect so strongly, it gets what is plausible: no spring is thirteen times too stiff.
    """
    by_kind = table()[motion][effect]
    kinds = ["robot"] if "robot" in by_kind else _kinds(where)
    found = [_inverse(by_kind[kind], wanted) for kind in kinds if kind in by_kind]
    if not found:
        raise ValueError(f"{effect} at {where} has no strength in {motion}")
    return float(np.exp(np.mean(np.log(found))))


def _kinds(where: str) -> Sequence[str]:
    named = [kind for kind in KINDS if kind in where]
    return named or KINDS


def _inverse(pairs: list[list[float]], wanted: float) -> float:
    parameter, strengths = np.log(np.array(pairs)).T
    order = np.argsort(strengths)
    parameter, strengths, goal = parameter[order], strengths[order], np.log(wanted)
    if len(parameter) == 1:
        return float(np.exp(parameter[0] + goal - strengths[0]))
    i = int(np.clip(np.searchsorted(strengths, goal), 1, len(strengths) - 1))
    slope = (parameter[i] - parameter[i - 1]) / max(strengths[i] - strengths[i - 1], 1e-9)
    found = np.exp(parameter[i] + np.clip(slope, 0.2, 5.0) * (goal - strengths[i]))
    return float(np.clip(found, np.exp(parameter.min()) / BEYOND, np.exp(parameter.max()) * BEYOND))
