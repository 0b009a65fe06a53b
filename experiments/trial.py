"""One trial of a motion: which numbers of the plant are off, how noisy its sensors are, who pushes it."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from experiments.effects.compose import EffectNumbers
from experiments.effects.ground import tilt as tilt_ground
from experiments.effects.places import mask
from experiments.plant import Plant, PlantParams

Array = jax.Array

NOISE_ROWS = 4096  # 10 s of control periods before a trial's sensor noise repeats
NOISE_COLUMNS = 64


def _scale_drive(*fields: str) -> Callable:
    return lambda params, x: params._replace(
        drive=params.drive._replace(**{f: getattr(params.drive, f) * x for f in fields})
    )


def _bodies(change: Callable) -> Callable:
    return lambda params, x: params._replace(bodies=change(params.bodies, x))


def _torso_mass(bodies, x):
    factor = jnp.ones(13, jnp.float32).at[0].set(x)
    return bodies._replace(mass=bodies.mass * factor, inertia=bodies.inertia * factor[:, None])


def _link_mass(bodies, x):
    factor = jnp.full(13, x).at[0].set(1.0)
    return bodies._replace(mass=bodies.mass * factor, inertia=bodies.inertia * factor[:, None])


class Perturbation(NamedTuple):
    """A number of the plant that a trial may draw: its unit, its nominal value and what it changes."""

    unit: str
    nominal: float
    about: str
    apply: Callable[[PlantParams, Array], PlantParams]


PERTURBATIONS: Mapping[str, Perturbation] = MappingProxyType(
    {
        "torso_mass": Perturbation("1", 1.0, "torso mass and inertia, factor", _bodies(_torso_mass)),
        "link_mass": Perturbation("1", 1.0, "mass and inertia of all links, factor", _bodies(_link_mass)),
        "inertia": Perturbation(
            "1", 1.0, "inertia of all bodies, factor", _bodies(lambda b, x: b._replace(inertia=b.inertia * x))
        ),
        "torso_com_x": Perturbation(
            "m",
            0.0,
            "torso centre of mass forward",
            _bodies(lambda b, x: b._replace(com=b.com.at[0, 0].add(x))),
        ),
        "torso_com_y": Perturbation(
            "m",
            0.0,
            "torso centre of mass to the left",
            _bodies(lambda b, x: b._replace(com=b.com.at[0, 1].add(x))),
        ),
        "ground_friction": Perturbation(
            "1",
            1.0,
            "friction of the ground, factor",
            _bodies(lambda b, x: b._replace(friction=b.friction * x)),
        ),
        "restitution": Perturbation(
            "1",
            0.0,
            "Newton's restitution of the feet",
            _bodies(lambda b, x: b._replace(restitution=b.restitution + x)),
        ),
        "ground_compliance": Perturbation(
            "m/N", 0.0, "ground compliance", _bodies(lambda b, x: b._replace(compliance=b.compliance + x))
        ),
        "slope_x": Perturbation(
            "m/m",
            0.0,
            "rise of the ground along x",
            _bodies(lambda b, x: tilt_ground(_XY(x, 0.0 * x), b)),
        ),
        "slope_y": Perturbation(
            "m/m",
            0.0,
            "rise of the ground along y",
            _bodies(lambda b, x: tilt_ground(_XY(0.0 * x, x), b)),
        ),
        "gear_friction": Perturbation(
            "1",
            1.0,
            "gear friction, factor",
            _scale_drive("friction_coulomb", "friction_viscous", "friction_cubic"),
        ),
        "spring_stiffness": Perturbation("1", 1.0, "spring stiffness, factor", _scale_drive("spring_stiffness")),
        "spring_damping": Perturbation("1", 1.0, "spring damping, factor", _scale_drive("spring_damping")),
        "torque_constant": Perturbation(
            "1",
            1.0,
            "torque and back-EMF constant, factor",
            _scale_drive("torque_constant", "back_emf_constant"),
        ),
        "motor_inertia": Perturbation("1", 1.0, "motor inertia, factor", _scale_drive("motor_inertia")),
        "resistance": Perturbation("1", 1.0, "winding resistance, factor", _scale_drive("resistance")),
        "battery_voltage": Perturbation("1", 1.0, "bus voltage, factor", _scale_drive("bus_voltage")),
    }
)

# Disturbances that act during the trial instead of changing a number of the plant.
DISTURBANCES: Mapping[str, tuple[str, float, str]] = MappingProxyType(
    {
        "push_x": ("N", 0.0, "horizontal push on the torso along the world's x"),
        "push_y": ("N", 0.0, "horizontal push on the torso along the world's y"),
        "push_start": ("s", 0.5, "when the push starts"),
        "push_duration": ("s", 0.5, "how long it lasts"),
        "sensor_noise": ("1", 0.0, "sensor noise, factor on the logs' usual standard deviations"),
        "encoder_bias": ("rad", 0.0, "standard deviation of constant joint encoder errors"),
    }
)


class _XY(NamedTuple):
    x: Array
    y: Array


class Trial(NamedTuple):
    """Numbers of one trial by name, plus the row at which its sensor noise starts."""

    numbers: dict[str, Array]  # names of PERTURBATIONS and DISTURBANCES, and `effect@place.parameter`
    noise: Array  # (NOISE_ROWS, NOISE_COLUMNS) standard normal numbers, shared by all trials
    noise_start: Array  # () int32

    def get(self, name: str) -> Array:
        """A disturbance of this trial, or its nominal value."""
        return self.numbers.get(name, jnp.float32(DISTURBANCES[name][1]))

    def apply(self, plant: Plant, params: PlantParams) -> PlantParams:
        """The plant's numbers with this trial's perturbed ones."""
        for name, value in self.numbers.items():
            if name in PERTURBATIONS:
                params = PERTURBATIONS[name].apply(params, value)
            elif "@" in name:
                params = params._replace(effects=_set_effect(plant, params.effects, name, value))
        return params


def _set_effect(plant: Plant, numbers: EffectNumbers, name: str, value: Array) -> EffectNumbers:
    """`effect@place.parameter` set to a value where the effect acts."""
    place, parameter = name.rsplit(".", 1)
    index = plant.placed.index(place)
    here = mask(place.split("@")[1], plant.effects.effects[index].axis)
    old = numbers[index][parameter]
    new = jnp.where(here.reshape(old.shape) > 0, value, old)
    return (*numbers[:index], {**numbers[index], parameter: new}, *numbers[index + 1 :])


def nominal_trial() -> Trial:
    """Nothing is off, no noise, no push."""
    return Trial({}, noise_table(), jnp.zeros((), jnp.int32))


def noise_table(seed: int = 0) -> Array:
    """Standard normal numbers from which every trial takes its sensor noise, at its own starting row."""
    numbers = np.random.default_rng(seed).standard_normal((NOISE_ROWS, NOISE_COLUMNS))
    return jnp.asarray(numbers, jnp.float32)


def noise_row(trial: Trial, tick: Array) -> Array:
    """This tick's sensor noise (NOISE_COLUMNS,), scaled by the trial; zeros if the trial has no noise."""
    if "sensor_noise" not in trial.numbers:
        return jnp.zeros(NOISE_COLUMNS, jnp.float32)
    row = (trial.noise_start + tick) % NOISE_ROWS
    return trial.numbers["sensor_noise"] * jax.lax.dynamic_index_in_dim(trial.noise, row, keepdims=False)


def push_at(trial: Trial, time: Array) -> Array:
    """Wrench of the push (6,) in the world frame at a time."""
    if not {"push_x", "push_y"} & set(trial.numbers):
        return jnp.zeros(6, jnp.float32)
    start = trial.get("push_start")
    on = (time >= start) & (time < start + trial.get("push_duration"))
    zero = jnp.zeros((), jnp.float32)
    wrench = jnp.stack([trial.get("push_x"), trial.get("push_y"), zero, zero, zero, zero])
    return jnp.where(on, wrench, 0.0)


def trials_from_columns(columns: Mapping[str, Sequence[float]], noise_start: Sequence[int]) -> Trial:
    """Many trials as one pytree with a leading axis; the noise table stays shared (see `TRIAL_AXES`)."""
    numbers = {name: jnp.asarray(values, jnp.float32) for name, values in columns.items()}
    return Trial(numbers, noise_table(), jnp.asarray(noise_start, jnp.int32))
