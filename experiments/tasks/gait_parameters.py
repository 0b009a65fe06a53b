"""Names of the gait controller's numbers: which of them a task may search, and how a file gives all of them.

What all gaits share stands in gait_controller.json, with its sources; a task file gives what differs; what follows
from the robot is taken from the robot.
"""

from collections.abc import Mapping, Sequence
from importlib import resources
from types import MappingProxyType
from typing import Any, Final, NamedTuple, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np

from controller_jax.careful_gait import CautionParams
from controller_jax.geometry import JOINTS, geometry_from_numbers
from controller_jax.leg_kinematics import leg_mass
from controller_jax.locomotion import GaitParams
from controller_jax.types import LegGeometry
from controller_jax.velocity_command import VelocityCommand
from experiments.errors import UserError
from experiments.files import read_json, shown

MAX_BYTES = 1_000_000
# rad and m/s that no ground and no gait has
NEVER: Final[Mapping[str, Any]] = MappingProxyType({name: [1e3, 2e3] for name in ("slope", "excess", "tilt")})
# Numbers of the controller that are vectors, and their lengths; all others are scalars.
VECTORS: Final[Mapping[str, int]] = MappingProxyType(
    dict.fromkeys((f"gains.{kind}_{gain}" for kind in ("force", "torque") for gain in "pid"), 3)
    | dict.fromkeys(("torso.once_per_cycle", "torso.twice_per_cycle", "torso.speed_lead"), 2)
    | dict.fromkeys(("foothold.feedback", "foothold.heading_offset", "foothold.lateral_offset"), 2)
    | {"distribution.wrench_weight": 6, "gains.inertia": 3, "torso.slope_share": 2}
    | {f"caution.{name}": 2 for name in NEVER}
)

Array = jax.Array

# Searchable name -> the places of GaitParams that take its value: fields, and the index where the last is a vector.
PARAMETERS: Final[Mapping[str, tuple[tuple[str | int, ...], ...]]] = MappingProxyType(
    {
        "cycle_duration": (("gait", "cycle_duration"),),
        "duty_factor": (("gait", "fore_duty"), ("gait", "hind_duty")),
        "fore_duty_factor": (("gait", "fore_duty"),),
        "hind_duty_factor": (("gait", "hind_duty"),),
        "fore_lag": (("gait", "fore_lag"),),
        "hind_lag": (("gait", "hind_lag"),),
        "pair_lag": (("gait", "pair_lag"),),
        "torso_height": (("torso", "height"),),
        "once_per_cycle": (("torso", "once_per_cycle", 0), ("torso", "once_per_cycle", 1)),
        "twice_per_cycle": (("torso", "twice_per_cycle", 0), ("torso", "twice_per_cycle", 1)),
        "fore_once_per_cycle": (("torso", "once_per_cycle", 0),),
        "hind_once_per_cycle": (("torso", "once_per_cycle", 1),),
        "fore_twice_per_cycle": (("torso", "twice_per_cycle", 0),),
        "hind_twice_per_cycle": (("torso", "twice_per_cycle", 1),),
        "phase_shift": (("torso", "phase_shift"),),
        "hop": (("torso", "hop"),),
        "hop_pitch": (("torso", "hop_pitch"),),
        "heading_lead": (("torso", "speed_lead", 0),),
        "swing_apex": (("swing", "apex_height"),),
        "landing_height": (("swing", "landing_height"),),
        "balance_feedback": (("foothold", "feedback", 0), ("foothold", "feedback", 1)),
        "heading_feedback": (("foothold", "feedback", 0),),
        "lateral_feedback": (("foothold", "feedback", 1),),
        "speed_feed_forward": (("foothold", "feed_forward"),),
        "fore_heading_offset": (("foothold", "heading_offset", 0),),
        "hind_heading_offset": (("foothold", "heading_offset", 1),),
        "lateral_offset": (("foothold", "lateral_offset", 0), ("foothold", "lateral_offset", 1)),
        "heading_damping": (("gains", "force_d", 0),),
        "lateral_stiffness": (("gains", "force_p", 1),),
        "lateral_damping": (("gains", "force_d", 1),),
        "vertical_stiffness": (("gains", "force_p", 2),),
        "vertical_damping": (("gains", "force_d", 2),),
        "roll_stiffness": (("gains", "torque_p", 0),),
        "roll_damping": (("gains", "torque_d", 0),),
        "pitch_stiffness": (("gains", "torque_p", 1),),
        "pitch_damping": (("gains", "torque_d", 1),),
        "yaw_damping": (("gains", "torque_d", 2),),
    }
)


class GaitSettings(NamedTuple):
    """What is not searched, beside the searched numbers' first values."""

    geometry: LegGeometry
    distribution: Any  # of the force distribution; replaces the one in `controller`
    controller: GaitParams
    careful: GaitParams  # what it goes over to where care is due
    caution: CautionParams
    command: VelocityCommand
    flight: Array  # () wanted share of the stride with all feet in the air
    turn_start: Array  # () s, when the turning command sets in

    def command_at(self, time: Array) -> VelocityCommand:
        """The command at a time, s."""
        return self.command._replace(turning=jnp.where(time >= self.turn_start, self.command.turning, 0.0))


def with_values(controller: GaitParams, names: Sequence[str], values: Array) -> GaitParams:
    """The controller with values (n,) put in the places of their names."""
    for index, name in enumerate(names):
        for place in PARAMETERS[name]:
            controller = _put(controller, place, values[index])
    return controller


def _put(node: Any, place: tuple[str | int, ...], value: Array) -> Any:
    head, *rest = place
    if isinstance(head, int):
        return jnp.where(np.arange(node.shape[0]) == head, value, node)  # a scatter would stay in the loop over ticks
    return node._replace(**{head: _put(getattr(node, head), tuple(rest), value) if rest else value})


def check_names(names: Sequence[str], task: str) -> None:
    """Raises UserError for a parameter that the gait controller does not have."""
    for name in names:
        if name not in PARAMETERS:
            raise UserError(f"Task {task}: no parameter '{shown(name)}'; choose among {', '.join(PARAMETERS)}.")


def controller_from_settings(numbers: Mapping[str, Any], robot: Mapping[str, Any], task: str) -> GaitParams:
    """The controller of a task file: nested objects named as the fields of GaitParams, vectors as lists.

    Numbers that the file does not give are those of gait_controller.json; `robot_numbers` gives those of the robot
    (its file as a dictionary). Raises UserError for a missing, unknown or misformed number.
    """
    with resources.as_file(resources.files("experiments") / "gait_controller.json") as path:
        shared = read_json(path, MAX_BYTES)
    shared = {name: value for name, value in shared.items() if name not in ("about", "sources")}
    return _read(GaitParams, _merged(shared, numbers), robot_numbers(robot), "", task)


def careful_from_settings(
    settings: Any, controller: GaitParams, robot: Mapping[str, Any], task: str
) -> tuple[GaitParams, CautionParams]:
    """The careful form of a gait, given like its controller, and when it goes over to it; without one it stays itself.

    A slope, an excess of speed or a tilt that the file does not give never asks for care. Raises UserError for a
    missing, unknown or misformed number.
    """
    if settings is None:
        return controller, _read(CautionParams, {**NEVER, "rise": 1.0, "calm": 1.0}, {}, "caution", task)
    both = isinstance(settings, Mapping) and set(settings) == {"caution", "controller"}
    if not both or not isinstance(settings["caution"], Mapping):
        raise UserError(f"Task {task}: settings.careful must be an object of caution and controller.")
    caution = _read(CautionParams, {**NEVER, **settings["caution"]}, {}, "caution", task)
    if not all(float(one[0]) < float(one[1]) for one in (caution.slope, caution.excess, caution.tilt)):
        raise UserError(
            f"Task {task}: settings.careful.caution: slope, excess and tilt must be two growing numbers each."
        )
    if min(float(caution.rise), float(caution.calm)) <= 0.0:
        raise UserError(f"Task {task}: settings.careful.caution: rise and calm must be more than zero seconds.")
    return controller_from_settings(settings["controller"], robot, f"{task}, careful form"), caution


def robot_numbers(robot: Mapping[str, Any]) -> dict[str, Array]:
    """The controller's numbers that follow from the robot's file, by their places.

    A drive in position mode runs at a (q_d - theta) + b (q_d - q) - c qd: along a ramp it stays behind by
    (1 + c) / (a + b) seconds, which is what the swing leads by.
    """
    geometry = geometry_from_numbers(robot)
    mode = [robot["loops"]["position_mode"][joint] for joint in JOINTS]
    return {
        "distribution.torque_limits": geometry.torque_limits,
        "gains.mass": geometry.torso_mass + 4.0 * leg_mass(geometry),
        "torso.girdle_distance": geometry.r_BH_B[0, 0] - geometry.r_BH_B[2, 0],
        "swing.position_lead": jnp.float32([(1.0 + m["c"]) / (m["a"] + m["b"]) for m in mode]),
        "swing.joint_speed_limit": jnp.float32(robot["loops"]["gear_speed_limit"]),
    }


def _merged(shared: Any, own: Any) -> Any:
    if not isinstance(own, Mapping):
        return own
    shared = shared if isinstance(shared, Mapping) else {}
    return {**shared, **{name: _merged(shared.get(name), value) for name, value in own.items()}}


def _read(kind: type, numbers: Any, given: Mapping[str, Array], path: str, task: str) -> Any:
    if not isinstance(numbers, Mapping):
        raise UserError(f"Task {task}: settings.controller{path and '.' + path} must be an object of named numbers.")
    hints = get_type_hints(kind)
    fields = [name for name in hints if _join(path, name) not in given]
    wrong = set(numbers) ^ set(fields)
    if wrong:
        name = min(wrong)
        what = "lacks" if name in fields else "does not know"
        raise UserError(f"Task {task}: settings.controller{path and '.' + path} {what} '{name}'.")
    values = {}
    for name, hint in hints.items():
        where = _join(path, name)
        if where in given:
            values[name] = given[where]
        elif hasattr(hint, "_fields"):
            values[name] = _read(hint, numbers[name], given, where, task)
        else:
            values[name] = _number(numbers[name], VECTORS.get(where, 0), where, task)
    return kind(**values)


def _number(value: Any, length: int, where: str, task: str) -> Array:
    try:
        array = np.asarray(value, np.float32)
    except (TypeError, ValueError):
        array = np.asarray(np.nan)
    if array.shape != ((length,) if length else ()) or not np.all(np.isfinite(array)):
        wanted = f"a list of {length} numbers" if length else "a number"
        raise UserError(f"Task {task}: settings.controller.{where} must be {wanted}.")
    return jnp.asarray(array)


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name
