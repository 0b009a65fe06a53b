"""Answers against the sealed truth: the figures that a diagnosis is judged by."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from experiments.effects.places import mask
from mjx_starleth.names import JOINT_NAMES
from mjx_starleth.numbers import load_numbers

STRONG = 0.05  # RMS of the effect's torque over that of the command, from which it has to be found
AT_FLOOR = 1.15  # held-out error over the noise up to which a log counts as explained
# parameters that mean the same to the plant and the library: truth's name, answer's name
SAME_NUMBER = {
    "coulomb_friction": ("level", "torque"),
    "viscous_friction": ("coefficient", "coefficient"),
    "cubic_friction": ("coefficient", "coefficient"),
    "torque_constant": ("change", "relative"),
    "torque_constant_saturation": ("coefficient", "per_square_current"),
    "bus_voltage_sag": ("resistance", "resistance"),
    "backlash": ("half_width", "half_width"),
    "spring_stiffness": ("change", "relative"),
    "spring_stiffening": ("coefficient", "cubic"),
    "spring_damping": ("added", "coefficient"),
    "joint_coulomb_drag": ("level", "torque"),
    "joint_viscous_drag": ("coefficient", "coefficient"),
    "payload": ("mass", "mass"),
    "constant_force": ("x", "x"),
    "ground_friction": ("change", "relative"),
    "ground_compliance": ("compliance", "compliance"),
    "ground_slope": ("x", "x"),
    "command_delay": ("delay", "delay"),
    "sensor_delay": ("delay", "joint_side"),
    "joint_encoder_offset": ("offset", "offset"),
    "torque_sensor_gain": ("change", "relative"),
    "torque_sensor_offset": ("offset", "offset"),
}
# and how many of the library's units one of the plant's is, where they differ
UNITS = {"ground_friction": 1.0 / load_numbers().contact.friction}  # of the coefficient; relative to the nominal one
RIGID_ROTOR = "bench_rigid"

Case = Mapping[str, Any]
Answer = Mapping[str, Any]


def table(truth: Mapping[str, Case], answers: Mapping[str, Mapping[str, Answer]], method: str) -> dict[str, Any]:
    """Figures of one method over all cases that it answered; a rate is [hits, cases]."""
    pairs = [(truth[name], given[method]) for name, given in answers.items() if method in given]
    single = [(t, a) for t, a in pairs if t["group"] == "single" and t["effects"][0]["strength"] >= STRONG]
    rich = [(t, a) for t, a in single if t["richness"] != "poor"]
    named = [(t, a) for t, a in rich if _first(t, a)]
    outside = [(t, a) for t, a in pairs if t["group"] == "outsider" and t["effects"][0]["strength"] >= STRONG]
    intervals = [hit for t, a in named for hit in _held(t, a)]
    return {
        "method": method,
        "right_effect_first": _rate(_first(t, a) for t, a in rich),
        "right_place": _rate(_place(t, a) for t, a in named),
        "false_alarms": _rate(bool(a["effects"]) for t, a in pairs if t["group"] == "none"),
        "down_to_noise": _rate(a["held_out_rms"] <= AT_FLOOR for t, a in named if a.get("held_out_rms") is not None),
        "both_of_two": _rate(_both(t, a) for t, a in pairs if t["group"] == "pair"),
        "outsiders_unknown": _rate(a["verdict"] == "unknown" for t, a in outside),
        "outsiders_confident": _rate(a["verdict"] == "explained" for t, a in outside),
        "removed_unknown": _rate(a["verdict"] == "unknown" for t, a in rich) if method == "removed" else [0, 0],
        "removed_confident": _rate(a["verdict"] == "explained" for t, a in rich) if method == "removed" else [0, 0],
        "intervals_hold": _rate(intervals),
    }


def confusions(truth: Mapping[str, Case], answers: Mapping[str, Mapping[str, Answer]]) -> list[str]:
    """One line for each case that the diagnosis got wrong."""
    lines = []
    for name, given in answers.items():
        if "diagnosis" not in given:
            continue
        case, answer = truth[name], given["diagnosis"]
        hidden = ", ".join(f"{e['effect']}@{e['where']} ({e['strength']:.2f})" for e in case["effects"]) or "none"
        told = ", ".join(f"{e['effect']}@{e['where']}" for e in answer["effects"]) or "none"
        right = {e["effect"] for e in case["effects"] if e["in_library"]} == {e["effect"] for e in answer["effects"]}
        if not right:
            lines.append(f"{name} {case['motion']}: {hidden} -> {answer['verdict']}: {told}")
    return lines


def _rate(hits: Iterable[bool]) -> list[int]:
    hits = list(hits)
    return [int(sum(hits)), len(hits)]


def _first(case: Case, answer: Answer) -> bool:
    return bool(answer["effects"]) and answer["effects"][0]["effect"] == case["effects"][0]["effect"]


def _place(case: Case, answer: Answer) -> bool:
    return _same_place(case["effects"][0]["where"], answer["effects"][0]["where"])


def _both(case: Case, answer: Answer) -> bool:
    return {e["effect"] for e in case["effects"]} <= {e["effect"] for e in answer["effects"]}


def _same_place(one: str, other: str) -> bool:
    if one == other or "axis" in (one, other):
        return True
    try:
        return bool(np.array_equal(*(mask(where, "joint", JOINT_NAMES) for where in (one, other))))
    except ValueError:
        return False


def _held(case: Case, answer: Answer) -> list[bool]:
    """Whether the interval holds the truth, for effects whose numbers mean the same on both sides."""
    effect, told = case["effects"][0], answer["effects"][0]
    if effect["effect"] not in SAME_NUMBER or case["motion"] == RIGID_ROTOR or not told["parameters"]:
        return []
    hidden, named = SAME_NUMBER[effect["effect"]]
    low, high = told["parameters"][named]["ci95"]
    return [low <= UNITS.get(effect["effect"], 1.0) * effect["parameters"][hidden]["value"] <= high]
