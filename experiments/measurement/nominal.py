"""What may be a little off without being a missing effect: the robot's nominal numbers, and the timing of its loops."""

from collections.abc import Sequence

from experiments.effects.delay import LOOP_LAG
from experiments.effects.effect import Effect
from experiments.measurement.refit import Nominal
from experiments.model import JointNumbers, Model

WIDE = 0.06  # relative standard deviation of the numbers of a robot that is not quite its data sheet
LAG = 1.5e-4  # s, standard deviation of when the velocity loops run within their 0.5 ms


def timing(effects: Sequence[Effect]) -> tuple[Nominal, ...]:
    """What no log tells and no robot's model can know: the phase of the velocity loops."""
    return (Nominal(LOOP_LAG.name, "all", "lag", LAG),) if LOOP_LAG in effects else ()


def nominal_freedom(model: Model, effects: Sequence[Effect]) -> tuple[Nominal, ...]:
    """Nominal numbers that may be a little off, as far as these effects can express it."""
    known = {effect.name for effect in effects}
    return tuple(n for n in _freedom(model) if n.effect in known)


def _freedom(model: Model) -> tuple[Nominal, ...]:
    """Nominal numbers that may be off, each robot-wide or by kind of joint, as its numbers are given."""
    if model.joint is not None:
        return joint_freedom(model.joint)
    n = model.numbers
    drive = n.drive
    springs = [Nominal("spring_stiffness", kind, "relative", WIDE) for kind in ("HAA", "HFE", "KFE")]
    dampers = [
        Nominal("spring_damping", kind, "coefficient", WIDE * getattr(drive.spring_damping, kind))
        for kind in ("HAA", "HFE", "KFE")
    ]
    links = [Nominal("link_mass", kind, "relative", WIDE) for kind in ("HAA", "HFE", "KFE")]
    gears = [
        Nominal(effect, kind, parameter, WIDE * size)
        for effect, parameter, size in (
            ("coulomb_friction", "torque", drive.friction_coulomb),
            ("viscous_friction", "coefficient", drive.friction_viscous),
            ("motor_inertia", "relative", 1.0),
            ("torque_constant", "relative", 1.0),
        )
        for kind in ("HAA", "HFE", "KFE")
    ]
    return (
        *gears,
        Nominal("payload", "torso", "mass", WIDE * n.bodies.torso.mass),
        *springs,
        *dampers,
        *links,
    )


def joint_freedom(joint: JointNumbers) -> tuple[Nominal, ...]:
    """The same for a single joint on a bench."""
    found = [Nominal("motor_inertia", joint.name, "relative", WIDE)]
    if joint.viscous_friction > 0:
        found.append(Nominal("viscous_friction", joint.name, "coefficient", WIDE * joint.viscous_friction))
    if joint.gravity_load != 0:
        found.append(Nominal("gravity_load", joint.name, "torque", WIDE * abs(joint.gravity_load)))
    return tuple(found)
