"""One trial of a motion: which numbers of the plant are off, how noisy its sensors are, who pushes it."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from experiments.effects.compose import EffectNumbers
from experiments.effects.ground import tilt as tilt_ground
from experiments.effects.inertia import scaled
from experiments.plant import Plant, PlantParams
from experiments.sensing import NOISE
from mjx_starleth.terrain import Terrain

Array = jax.Array

# Sensor noise is one stream of rows: row i is the sum of rows i of two short tables that repeat at lengths without a
# common divisor, over root two. So the tables stay in the cache, and two trials hardly ever have the same window.
TABLE_ROWS = (4096, 4093)
NOISE_ROWS = TABLE_ROWS[0] * TABLE_ROWS[1]  # rows before the stream repeats: 11 hours of control periods
NOISE_COLUMNS = 64


def _scale_drive(*fields: str) -> Callable:
    return lambda params, x: params._replace(
        drive=params.drive._replace(**{f: getattr(params.drive, f) * x for f in fields})
    )


def _bodies(change: Callable) -> Callable:
    return lambda params, x: params._replace(bodies=change(params.bodies, x))


def _torso_mass(bodies, x):
    return scaled(bodies, jnp.ones(13, jnp.float32).at[0].set(x))


def _link_mass(bodies, x):
    return scaled(bodies, jnp.full(13, x).at[0].set(1.0))


def _shift_com(bodies, axis, x):
    return bodies._replace(com=jnp.asarray(bodies.com).at[0, axis].add(x))


class Perturbation(NamedTuple):
    """A number of the plant that a trial may draw: its unit, its nominal value, its range and what it changes."""

    unit: str
    nominal: float
    low: float
    high: float
    about: str
    apply: Callable[[PlantParams, Array], PlantParams]


def _factor(about: str, apply: Callable[[PlantParams, Array], PlantParams]) -> Perturbation:
    return Perturbation("1", 1.0, 0.01, 100.0, f"{about}, factor", apply)


PERTURBATIONS: Mapping[str, Perturbation] = MappingProxyType(
    {
        "torso_mass": _factor("torso mass and inertia", _bodies(_torso_mass)),
        "link_mass": _factor("mass and inertia of all links", _bodies(_link_mass)),
        "inertia": _factor("inertia of all bodies", _bodies(lambda b, x: b._replace(inertia=b.inertia * x))),
        "torso_com_x": Perturbation(
            "m", 0.0, -0.3, 0.3, "torso centre of mass forward", _bodies(lambda b, x: _shift_com(b, 0, x))
        ),
        "torso_com_y": Perturbation(
            "m", 0.0, -0.3, 0.3, "torso centre of mass to the left", _bodies(lambda b, x: _shift_com(b, 1, x))
        ),
        "ground_friction": _factor("friction of the ground", _bodies(lambda b, x: b._replace(friction=b.friction * x))),
        "restitution": Perturbation(
            "1",
            0.0,
            0.0,
            1.0,
            "Newton's restitution of the feet",
            _bodies(lambda b, x: b._replace(restitution=b.restitution + x)),
        ),
        "ground_compliance": Perturbation(
            "m/N",
            0.0,
            0.0,
            1e-3,
            "ground compliance",
            _bodies(lambda b, x: b._replace(compliance=b.compliance + x)),
        ),
        "slope_x": Perturbation(
            "m/m", 0.0, -0.6, 0.6, "rise of the ground along x", _bodies(lambda b, x: tilt_ground(_XY(x, 0.0 * x), b))
        ),
        "slope_y": Perturbation(
            "m/m", 0.0, -0.6, 0.6, "rise of the ground along y", _bodies(lambda b, x: tilt_ground(_XY(0.0 * x, x), b))
        ),
        "gear_friction": _factor(
            "gear friction", _scale_drive("friction_coulomb", "friction_viscous", "friction_cubic")
        ),
        "spring_stiffness": _factor("spring stiffness", _scale_drive("spring_stiffness")),
        "spring_damping": _factor("spring damping", _scale_drive("spring_damping")),
        "torque_constant": _factor(
            "torque and back-EMF constant", _scale_drive("torque_constant", "back_emf_constant")
        ),
        "motor_inertia": _factor("motor inertia", _scale_drive("motor_inertia")),
        "resistance": _factor("winding resistance", _scale_drive("resistance")),
        "battery_voltage": _factor("bus voltage", _scale_drive("bus_voltage")),
    }
)


class Disturbance(NamedTuple):
    """Something that acts during a trial, or on its ground, instead of changing a number of the robot."""

    unit: str
    nominal: float
    low: float
    high: float
    about: str


DISTURBANCES: Mapping[str, Disturbance] = MappingProxyType(
    {
        "push_x": Disturbance("N", 0.0, -1e4, 1e4, "horizontal push on the torso along the world's x"),
        "push_y": Disturbance("N", 0.0, -1e4, 1e4, "horizontal push on the torso along the world's y"),
        "push_start": Disturbance("s", 0.5, 0.0, 1e3, "when the push starts"),
        "push_duration": Disturbance("s", 0.5, 0.0, 1e3, "how long it lasts"),
        "obstacle_height": Disturbance("m", 0.0, -0.5, 0.5, "a board on the ground that nobody knows of; <0: a hole"),
        "obstacle_x": Disturbance("m", 0.25, -100.0, 100.0, "where the board's middle is, along x"),
        "obstacle_y": Disturbance("m", 0.0, -100.0, 100.0, "where the board's middle is, along y"),
        "obstacle_length": Disturbance("m", 0.2, 0.02, 100.0, "size of the board along x"),
        "obstacle_width": Disturbance("m", 0.2, 0.02, 100.0, "size of the board along y"),
        "sensor_noise": Disturbance("1", 0.0, 0.0, 1e3, "sensor noise, factor on the logs' usual standard deviations"),
        "encoder_bias": Disturbance("rad", 0.0, 0.0, 0.3, "standard deviation of constant joint encoder errors"),
        "torque_bias": Disturbance("N m", 0.0, 0.0, 10.0, "standard deviation of constant torque sensor errors"),
        "gyro_bias": Disturbance("rad/s", 0.0, 0.0, 1.0, "standard deviation of constant angular velocity errors"),
    }
)

# Biases are the constant part of a trial's sensor noise: columns of a noise row, and what one unit of them stands for.
BIASES: Mapping[str, tuple[slice, float]] = MappingProxyType(
    {
        "encoder_bias": (slice(0, 12), NOISE.joint_position),
        "torque_bias": (slice(24, 36), NOISE.joint_torque),
        "gyro_bias": (slice(57, 60), NOISE.base_angular_velocity),
    }
)
OBSTACLE_FLANK = 0.01  # m, as steep as a foot of 2 cm radius can tell from an edge


class _XY(NamedTuple):
    x: Array
    y: Array


class Trial(NamedTuple):
    """Numbers of one trial by name, plus the row at which its sensor noise starts."""

    numbers: dict[str, Array]  # names of PERTURBATIONS and DISTURBANCES, and `effect@place.parameter`
    noise: Array  # (sum of TABLE_ROWS, NOISE_COLUMNS) standard normal numbers, shared by all trials
    noise_start: Array  # () int32, row of the stream, below NOISE_ROWS

    def get(self, name: str) -> Array:
        """A disturbance of this trial, or its nominal value."""
        return self.numbers.get(name, jnp.float32(DISTURBANCES[name].nominal))

    def apply(self, plant: Plant, params: PlantParams) -> PlantParams:
        """The plant's numbers with this trial's perturbed ones."""
        for name, value in self.numbers.items():
            if name in PERTURBATIONS:
                params = PERTURBATIONS[name].apply(params, value)
            elif "@" in name:
                params = params._replace(effects=_set_effect(plant, params.effects, name, value))
        if "obstacle_height" in self.numbers:
            terrain = _with_obstacle(params.bodies.terrain, self)
            params = params._replace(bodies=params.bodies._replace(terrain=terrain))
        return params


def _set_effect(plant: Plant, numbers: EffectNumbers, name: str, value: Array) -> EffectNumbers:
    """`effect@place.parameter` set to a value where the effect acts."""
    place, parameter = name.rsplit(".", 1)
    _, index, here = next(one for one in plant.placements if one.name == place)
    old = numbers[index][parameter]
    new = jnp.where(here.reshape(old.shape), value, old)
    return (*numbers[:index], {**numbers[index], parameter: new}, *numbers[index + 1 :])


def _with_obstacle(terrain: Terrain, trial: Trial) -> Terrain:
    """The ground with one more obstacle, the trial's."""
    centre = jnp.stack([trial.get("obstacle_x"), trial.get("obstacle_y")])
    size = jnp.stack([trial.get("obstacle_length"), trial.get("obstacle_width")])
    one = {
        "obstacle_centre": centre[None],
        "obstacle_half_size": 0.5 * size[None],
        "obstacle_yaw": jnp.zeros(1),
        "obstacle_height": trial.get("obstacle_height")[None],
        "obstacle_flank": jnp.full(1, OBSTACLE_FLANK),
    }
    return terrain._replace(**{name: jnp.concatenate([getattr(terrain, name), new]) for name, new in one.items()})


def nominal_trial() -> Trial:
    """Nothing is off, no noise, no push."""
    return Trial({}, noise_table(), jnp.zeros((), jnp.int32))


def noise_table(seed: int = 0) -> Array:
    """The two tables of the noise's stream, one below the other."""
    numbers = np.random.default_rng(seed).standard_normal((sum(TABLE_ROWS), NOISE_COLUMNS))
    return jnp.asarray(numbers, jnp.float32)


def noise_row(trial: Trial, tick: Array) -> Array:
    """This tick's sensor noise and the trial's constant biases (NOISE_COLUMNS,); zeros if the trial has neither."""
    row = jnp.zeros(NOISE_COLUMNS, jnp.float32)
    if "sensor_noise" in trial.numbers:
        row = trial.numbers["sensor_noise"] * _row(trial, trial.noise_start + tick)
    for name in (n for n in BIASES if n in trial.numbers):
        columns, unit = BIASES[name]
        row = row.at[columns].add(trial.numbers[name] / unit * _row(trial, trial.noise_start - 1)[columns])
    return row


def _row(trial: Trial, index: Array) -> Array:
    first, second = TABLE_ROWS
    places = jnp.stack([index % first, first + index % second])
    rows = trial.noise.at[places].get(mode="promise_in_bounds")
    return (rows * np.float32(np.sqrt(0.5))).sum(0)


def push_at(trial: Trial, time: Array) -> Array:
    """Wrench of the push (6,) in the world frame at a time."""
    if not {"push_x", "push_y"} & set(trial.numbers):
        return jnp.zeros(6, jnp.float32)
    start = trial.get("push_start")
    on = (time >= start) & (time < start + trial.get("push_duration"))
    zero = jnp.zeros((), jnp.float32)
    wrench = jnp.stack([trial.get("push_x"), trial.get("push_y"), zero, zero, zero, zero])
    return jnp.where(on, wrench, 0.0)
