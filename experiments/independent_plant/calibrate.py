"""Make strengths.json: how strong every effect is in every motion, as a function of its scaled parameter.

    python -m experiments.independent_plant.calibrate

Every effect acts on all joints (or torso, feet) at a few sizes; the strength is read off joint kind by kind.
"""

import dataclasses
import json
import math
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from experiments.independent_plant.library import FAMILIES, Effect
from experiments.independent_plant.numbers import KINDS
from experiments.independent_plant.runner import PLATFORM, Case, record
from experiments.independent_plant.strength import TABLE, by_weight, needs_twin, strength

DURATION = 2.5  # s
SIZES = (0.15, 0.8, 4.0)  # times the middle below
BATCH = 36
# about 10 % of the commanded torque in the air, in the units of the effect's scaled parameter
MIDDLE = {
    "coulomb_friction": 2e-3,
    "viscous_friction": 1e-5,
    "cubic_friction": 2e-10,
    "stribeck_friction": 5e-3,
    "load_friction": 0.1,
    "direction_dependent_friction": 2e-3,
    "motor_inertia": 1.5e-6,
    "torque_constant": 0.1,
    "torque_constant_saturation": 0.02,
    "torque_ripple": 3e-3,
    "bus_voltage_sag": 1.0,
    "backlash": 5e-3,
    "spring_stiffness": 0.2,
    "spring_stiffening": 1000.0,
    "spring_damping": 0.2,
    "spring_hysteresis": 0.2,
    "joint_coulomb_drag": 0.2,
    "joint_viscous_drag": 0.1,
    "link_mass": 0.1,
    "payload": 2.5,
    "ground_friction": 0.3,
    "ground_compliance": 3e-5,
    "ground_slope": 0.1,
    "constant_force": 25.0,
    "command_delay": 2e-3,
    "joint_encoder_offset": 5e-3,
    "torque_sensor_gain": 0.15,
    "torque_sensor_offset": 0.2,
    "sensor_delay": 2e-3,
    "thermal_fade": 0.2,
    "warm_cogging": 3e-3,
    "drive_dropout": 0.7,
    "warmup_friction": 2e-5,
    "flexible_link": 5e-3,
    "cable_spring": 0.5,
    "joint_draft": 0.2,
    "vibration": 0.25,
    "encoder_eccentricity": 5e-3,
    "sloshing": 2.5,
    "wind": 15.0,
}
# effects that a robot on the ground survives only smaller than in the air, or that take more to be seen
GROUND_MIDDLE = {"load_friction": 0.05, "torque_constant": 0.15, "drive_dropout": 0.3, "coulomb_friction": 3e-3}
SIGN = {"ground_friction": -1.0}


def fits(motion: str, effect: str) -> bool:
    """Whether an effect can act at all in a motion."""
    family = FAMILIES[effect]
    platform = PLATFORM[motion]
    if platform != "ground" and "joints" not in family.places:
        return False
    if platform == "bench" and effect == "link_mass":
        return False
    rigid = ("friction", "rotor_torque", "link_torque", "measure")
    hooked = [name for name in rigid if name in vars(family)]
    elastic_only = ("load_friction", "torque_sensor", "sensor_delay", "motor_inertia")
    return platform != "bench_rigid" or (bool(hooked) and not effect.startswith(elastic_only))


def cases_of(motion: str) -> list[Case]:
    """Every effect that can act in the motion, on all joints, at every size."""
    cases = []
    for name, middle in MIDDLE.items():
        if not fits(motion, name):
            continue
        family = FAMILIES[name]
        where = "all" if "joints" in family.places else family.places[0]
        if PLATFORM[motion] == "ground":
            middle = GROUND_MIDDLE.get(name, middle)
        for size in SIZES:
            effect = Effect(name, where, {family.scaled: SIGN.get(name, 1.0) * float(f"{size * middle:.3g}")})
            cases.append(Case(motion, effects=(effect,), seed=7, duration=DURATION))
    return cases


def measure(cases: list[Case]) -> list[dict[str, float]]:
    """Joint kind or `robot` -> strength, for each of a batch of cases; nothing for a robot that fell."""
    recording = record([dataclasses.replace(cases[0], effects=()), *cases])
    found: list[dict[str, float]] = []
    for log, case in enumerate(cases, start=1):
        effect = case.effects[0]
        if recording.fallen[log]:
            found.append({})
        elif by_weight(effect) is not None or needs_twin(effect):
            found.append({"robot": by_weight(effect) or _against(recording, log)})
        else:
            found.append({k: strength(Effect(effect.effect, k), recording, log) for k in _kinds(case)})
    return found


def _against(recording, log: int) -> float:
    """Change of the joint torques against the first log of the batch, which is without effect."""
    changed = recording.true["joint_torque"][log] - recording.true["joint_torque"][0]
    return float(np.sqrt(np.square(changed).sum() / recording.command_power[log].sum()))


def _kinds(case: Case) -> tuple[str, ...]:
    drive = case.bench_drive
    return KINDS if drive in (None, "rigid") else (drive,)


def main() -> None:
    """Run all motions on two processes and write the table."""
    cases = [case for motion in PLATFORM for case in cases_of(motion)]
    parts = [[case for case in cases if case.motion == motion] for motion in PLATFORM]
    batches = [part[i : i + BATCH] for part in parts for i in range(0, len(part), BATCH)]
    table: dict[str, dict[str, dict[str, list[list[float]]]]] = {}
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for batch, results in zip(batches, pool.map(measure, batches)):
            print(batch[0].motion, flush=True)
            for case, strengths in zip(batch, results):
                effect = case.effects[0]
                size = abs(effect.parameters[effect.family.scaled])
                for place, value in strengths.items():
                    if math.isfinite(value) and value > 1e-4:
                        by_place = table.setdefault(case.motion, {}).setdefault(effect.effect, {})
                        by_place.setdefault(place, []).append([size, float(f"{value:.4g}")])
    TABLE.write_text(json.dumps(table, separators=(",", ":")).replace('},"', '},\n"') + "\n")


if __name__ == "__main__":
    main()
