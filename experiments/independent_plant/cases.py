"""The benchmark: a seeded list of cases over effect x strength x place x motion x noise, and cases without."""

from collections.abc import Sequence

import numpy as np

from experiments.independent_plant.library import FAMILIES, LIBRARY, OUTSIDERS, Effect
from experiments.independent_plant.numbers import JOINT_NAMES, KINDS, LEGS, UNCERTAIN, BodyNumbers
from experiments.independent_plant.runner import PLATFORM, Case
from experiments.independent_plant.sensors import SensorSettings
from experiments.independent_plant.strength import LEVELS, live_kinds, parameter_for, reachable, span

# How a log is measured: noise over the sensors' own, jitter [s], largest phase of the velocity loop [0.1 ms].
NOISE = {"quiet": (0.3, 0.0, 0), "usual": (1.0, 2e-6, 1), "rough": (2.0, 5e-6, 2)}
NOISE_SHARES = (0.15, 0.6, 0.25)
OFF_LEVELS, OFF_SHARES = (0.0, 0.03, 0.1), (0.3, 0.4, 0.3)
PLACE_SHARES = {"all": 0.3, "kind": 0.15, "leg": 0.15, "joint": 0.4}
MOTION_SHARES = {
    "air": 0.35,
    "air_torque": 0.15,
    "squat": 0.25,
    "hops": 0.1,
    "bench_HAA": 0.03,
    "bench_HFE": 0.03,
    "bench_KFE": 0.04,
    "bench_rigid": 0.05,
}
# The nominal number that an effect is a change of: it is exact in the cases of that effect, or the truth would be
# the sum of two.
SAME_AS = {
    "coulomb_friction": "friction_coulomb",
    "viscous_friction": "friction_viscous",
    "motor_inertia": "motor_inertia",
    "torque_constant": "torque_constant",
    "spring_stiffness": "spring_stiffness",
    "spring_damping": "spring_damping",
    "link_mass": "link_mass",
    "payload": "torso_mass",
    "ground_friction": "ground_friction",
}
EITHER_SIGN = (
    "torque_constant",
    "spring_stiffness",
    "direction_dependent_friction",
    "joint_encoder_offset",
    "torque_sensor_gain",
    "torque_sensor_offset",
)
# Share of the nominal number that an effect leaves at least: a spring does not pull where it should push.
LEAST_LEFT = {"ground_friction": 0.4, "spring_stiffness": 0.3, "torque_constant": 0.3}
SECONDARY = {
    "stribeck_friction": {"velocity": (10.0, 50.0)},
    "torque_ripple": {"phase": (-np.pi, np.pi)},
    "spring_hysteresis": {"width": (0.004, 0.02)},
    "payload": {"x": (-0.15, 0.15), "y": (-0.1, 0.1), "z": (0.05, 0.15)},
    "ground_compliance": {"damping": (50.0, 200.0)},
    "thermal_fade": {"time_constant": (2.0, 5.0)},
    "warm_cogging": {"harmonic": (20.0, 60.0)},
    "flexible_link": {"frequency": (8.0, 20.0)},
    "cable_spring": {"rest": (-0.2, 0.2)},
    "vibration": {"frequency": (6.0, 20.0)},
    "encoder_eccentricity": {"harmonic": (8.0, 15.0), "phase": (-np.pi, np.pi)},
    "wind": {"corner": (0.4, 1.0)},
}


def benchmark(seed: int = 0, size: int = 300, duration: float = 8.0) -> list[Case]:
    """`size` cases: 56 % one effect, 12 % none, 12 % pairs, 14 % outside the library, 6 % on motion too poor to tell.

    The same seed and size give the same list.
    """
    rng = np.random.default_rng([seed, 77])
    counts = {"none": 0.12, "pair": 0.12, "outsider": 0.14, "poor": 0.06}
    cases: list[Case] = []
    for group, share in counts.items():
        for i in range(round(share * size)):
            cases.append(_case(group, i, seed, len(cases), duration, rng))
    singles = size - len(cases)
    for i in range(singles):
        cases.append(_case("single", i, seed, len(cases), duration, rng))
    return cases


def _case(group: str, i: int, seed: int, number: int, duration: float, rng: np.random.Generator) -> Case:
    """One case; effects, levels and sizes of noise take turns so that each is met equally often."""
    names = OUTSIDERS if group == "outsider" else LIBRARY
    level = LEVELS[(i // len(names)) % len(LEVELS)] if group == "single" else float(rng.choice(LEVELS[1:]))
    effects: tuple[Effect, ...] = ()
    motion = _motion(MOTION_SHARES, rng)
    if group in ("single", "outsider", "poor"):
        motion, effects = _with_effect(names[i % len(names)] if group != "poor" else str(rng.choice(names)), level, rng)
    elif group == "pair":
        motion, effects = _with_pair(level, rng)
    quality = str(rng.choice(list(NOISE), p=NOISE_SHARES))
    noise, jitter, phase = NOISE[quality]
    off, bodies, load = _off(float(rng.choice(OFF_LEVELS, p=OFF_SHARES)), effects, rng)
    fast = motion.startswith(("air", "bench")) and rng.random() < 0.15
    return Case(
        motion=motion if group != "poor" or motion != "hops" else "squat",
        richness="poor" if group == "poor" else "fast" if fast else "rich",
        effects=effects,
        seed=seed * 100_000 + number,
        duration=duration,
        sensors=SensorSettings(noise, True, jitter),
        velocity_phase=int(rng.integers(0, phase + 1)),
        off=off,
        bodies=bodies,
        load_off=load,
        group=group,
    )


def _motion(shares: dict[str, float], rng: np.random.Generator) -> str:
    weights = np.array(list(shares.values()))
    return str(rng.choice(list(shares), p=weights / weights.sum()))


def _with_effect(name: str, level: float, rng: np.random.Generator) -> tuple[str, tuple[Effect, ...]]:
    """A motion in which the effect can be that strong, and the effect."""
    able = {motion: share for motion, share in MOTION_SHARES.items() if _able(motion, name, level)}
    if not able:  # nowhere so strong: as strong as it gets
        able = {motion: share for motion, share in MOTION_SHARES.items() if reachable(motion, name)}
    motion = _motion(able, rng)
    return motion, (draw_effect(name, motion, level, rng),)


def _with_pair(level: float, rng: np.random.Generator) -> tuple[str, tuple[Effect, ...]]:
    """Two different effects of about the same strength, at places of their own."""
    while True:
        motion, first = _with_effect(str(rng.choice(LIBRARY)), level, rng)
        others = [name for name in LIBRARY if name != first[0].effect and _able(motion, name, level)]
        if others and PLATFORM[motion] in ("fixed_base", "ground"):
            return motion, (*first, draw_effect(str(rng.choice(others)), motion, level, rng))


def _able(motion: str, name: str, level: float) -> bool:
    if not reachable(motion, name):
        return False
    least, most = span(motion, name)
    return 0.4 * least <= level <= 1.3 * most


def draw_effect(name: str, motion: str, level: float, rng: np.random.Generator, where: str | None = None) -> Effect:
    """An effect of about the wanted strength in a motion; place, sign and second parameters are drawn."""
    family = FAMILIES[name]
    where = where or _place(name, motion, rng)
    least, most = span(motion, name)
    size = parameter_for(motion, name, where, float(np.clip(level, 0.4 * least, 1.3 * most)))
    parameters = {key: float(rng.uniform(*bounds)) for key, bounds in SECONDARY.get(name, {}).items()}
    if name == "torque_ripple":
        parameters["harmonic"] = float(rng.choice([1.0, 2.0, 4.0])) * (20.0 if motion == "bench_rigid" else 1.0)
    if name in EITHER_SIGN:
        size *= float(rng.choice([-1.0, 1.0]))
    if name in LEAST_LEFT:
        size = max(-size if name == "ground_friction" else size, LEAST_LEFT[name] - 1.0)
    parameters[family.scaled] = size
    if name in ("constant_force", "ground_slope"):
        axes = "xyz" if name == "constant_force" else "xy"
        way = rng.standard_normal(len(axes))
        parameters |= dict(zip(axes, (size * way / np.linalg.norm(way)).tolist()))
    return Effect(name, where, parameters)


def _place(name: str, motion: str, rng: np.random.Generator) -> str:
    family = FAMILIES[name]
    if "joints" not in family.places:
        return family.places[0]
    if PLATFORM[motion].startswith("bench") or name == "bus_voltage_sag":
        return "all"
    shares = dict(PLACE_SHARES)
    if name in ("thermal_fade", "drive_dropout", "cable_spring", "flexible_link"):
        shares = {"joint": 1.0}
    choice = _motion(shares, rng)
    named: dict[str, Sequence[str]] = {"all": ["all"], "kind": KINDS, "leg": LEGS, "joint": JOINT_NAMES}
    places = [
        place
        for place in named[choice]
        if any(kind in place for kind in live_kinds(motion, name)) or choice in ("all", "leg")
    ]
    return str(rng.choice(places if places else ["all"]))


def _off(
    level: float, effects: tuple[Effect, ...], rng: np.random.Generator
) -> tuple[dict[str, tuple[float, float, float]], BodyNumbers, tuple[float, float, float]]:
    """Own numbers of a robot, each up to `level` off the nominal ones."""
    exact = {SAME_AS.get(effect.effect) for effect in effects}

    def factors(name: str, count: int) -> np.ndarray:
        drawn = rng.uniform(1.0 - level, 1.0 + level, count)
        return np.ones(count) if name in exact else drawn

    off = {name: tuple(factors(name, 3).tolist()) for name in UNCERTAIN} if level else {}
    bodies = BodyNumbers(
        torso_mass=float(factors("torso_mass", 1)[0]),
        link_mass=factors("link_mass", 3),
        link_com=factors("link_com", 3),
        ground_friction=float(factors("ground_friction", 1)[0]),
    )
    return off, bodies, tuple(rng.uniform(1.0 - level, 1.0 + level, 3).tolist())
