"""What may be a little off without being a missing effect: the robot's nominal numbers, and the timing of its loops."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from experiments.effects.delay import LOOP_TIMING
from experiments.effects.effect import Effect
from experiments.effects.inertia import LINK_COM
from experiments.effects.link import BEARING_FRICTION
from experiments.measurement.evidence.features import NUISANCES
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.fits.fit_variables import FARTHEST
from experiments.model import JointNumbers, Model
from mjx_starleth.numbers import RobotNumbers, load_numbers

WIDE = 0.06  # relative standard deviation of the numbers of a robot that is not quite its data sheet
PHASE = 2.5e-4  # s: the velocity loops may run at any time within their 0.5 ms
HALF_STEP = 5e-5  # s, of the motor: by which the steps of two plants may differ
AT_END = 0.99  # of its farthest, from which a number has nowhere to go
KNOWN = 0.3  # of its prior's deviation, to which a log has to tell a number for it to tell of the others
NOT_GIVEN = frozenset({LOOP_TIMING.name, BEARING_FRICTION.name})  # no data sheet tells them, none can be off
EXACT = 0.15  # of a number's prior deviation (1 % of most): no data sheet is more exact
SPARE = 2.0  # times what the robot's other numbers are off by, that one may be


def timing(effects: Sequence[Effect]) -> tuple[Nominal, ...]:
    """What no log tells and no robot's model can know: when within a row the loops run and the motor is stepped."""
    if LOOP_TIMING not in effects:
        return ()
    deviations = {"phase": PHASE, "angle_lead": HALF_STEP, "torque_lag": HALF_STEP}
    return tuple(Nominal(LOOP_TIMING.name, "all", name, deviation) for name, deviation in deviations.items())


def at_end(nominal: Sequence[Nominal], fit: Refitted) -> tuple[Nominal, ...]:
    """Numbers that a fit has as far off as they may be: what lies beyond is an effect."""
    return tuple(
        n
        for n, value in zip(nominal, fit.nominal, strict=True)
        if n.effect not in NUISANCES and abs(value) > AT_END * FARTHEST * n.deviation
    )


def as_far_as_others(nominal: Sequence[Nominal], fit: Refitted) -> tuple[Nominal, ...]:
    """The numbers, none free to be off by more than twice what the others of this robot turn out to be off by.

    Where most of a robot's numbers are within 3 %, one that is 10 % off is no tolerance but an effect.
    As many of the largest as one effect everywhere may have moved tell nothing of the others.
    """
    told = [
        (abs(value) / n.deviation, n.effect)
        for n, value, spread in zip(nominal, fit.nominal, fit.spread, strict=True)
        if n.effect not in NOT_GIVEN and spread < KNOWN * n.deviation
    ]
    largest = max(Counter(name for _, name in told).values(), default=0)
    if len(told) < 2 * (largest + 1):
        return tuple(nominal)
    typical = sorted((size for size, _ in told), reverse=True)[largest]
    narrower = min(SPARE * typical / FARTHEST, 1.0)
    return tuple(n if n.effect in NOT_GIVEN else n._replace(deviation=narrower * n.deviation) for n in nominal)


def numbers_among(effects: Sequence[Placed], nominal: Sequence[Nominal]) -> tuple[Placed, ...]:
    """Effects that may be no more than a nominal number that is off, at a place where such numbers are given."""
    reaches = {(n.effect, n.where, n.parameter): FARTHEST * n.deviation for n in nominal}
    return tuple(
        p
        for p in effects
        if all(abs(value) <= reaches.get((p.effect, p.where, name), 0.0) for name, value in p.parameters.items())
    )


def all_inexact(effects: Sequence[Placed], nominal: Sequence[Nominal]) -> bool:
    """Whether all effects, wherever they act, are numbers no farther off than data sheets are exact; False of none."""
    least_last = sorted(nominal, key=lambda n: -n.deviation)  # kinds of joints differ
    exact = {(n.effect, n.parameter): EXACT * n.deviation for n in least_last}
    values = [(p.effect, name, value) for p in effects for name, value in p.parameters.items()]
    return bool(values) and all(abs(value) <= exact.get((effect, name), 0.0) for effect, name, value in values)


def nominal_freedom(model: Model, effects: Sequence[Effect], standing: bool) -> tuple[Nominal, ...]:
    """Nominal numbers that may be a little off, as far as these effects can express it.

    standing: the robot stands on its legs, so that their bearings carry loads and its feet may slide.
    """
    known = {effect.name for effect in effects}
    return tuple(n for n in _freedom(model, standing) if n.effect in known)


def never_given(model: Model, effects: Sequence[Effect]) -> tuple[Nominal, ...]:
    """What is free in every fit of these effects: timing, and the friction of loaded bearings, which no robot's model
    has and every robot does."""
    bearings = (n for n in nominal_freedom(model, effects, standing=False) if n.effect == BEARING_FRICTION.name)
    return (*timing(effects), *bearings)


def _freedom(model: Model, standing: bool) -> tuple[Nominal, ...]:
    """Nominal numbers that may be off, each robot-wide or by kind of joint, as its numbers are given."""
    if model.joint is not None:
        return joint_freedom(model.joint)
    numbers, kinds = model.numbers, ("HAA", "HFE", "KFE")
    payload = Nominal("payload", "torso", "mass", WIDE * numbers.bodies.torso.mass)
    links = [Nominal(name, kind, "relative", WIDE) for name in ("link_mass", LINK_COM.name) for kind in kinds]
    bearings = Nominal(BEARING_FRICTION.name, "all", "coefficient", numbers.drive.bearing_friction_per_radial_load)
    ground = [Nominal("ground_friction", "feet", "relative", WIDE)] if standing else []
    return (*_drive_freedom(numbers, {kind: kind for kind in kinds}), payload, *links, bearings, *ground)


def _drive_freedom(numbers: RobotNumbers, places: Mapping[str, str]) -> Iterator[Nominal]:
    """Numbers of the drives of these kinds of joint, each at its place."""
    drive = numbers.drive
    for kind, where in places.items():
        yield Nominal("coulomb_friction", where, "torque", WIDE * drive.friction_coulomb)
        yield Nominal("viscous_friction", where, "coefficient", WIDE * drive.friction_viscous)
        yield Nominal("motor_inertia", where, "relative", WIDE)
        yield Nominal("torque_constant", where, "relative", WIDE)
        yield Nominal("spring_stiffness", where, "relative", WIDE)
        yield Nominal("spring_damping", where, "coefficient", WIDE * getattr(drive.spring_damping, kind))


def joint_freedom(joint: JointNumbers) -> tuple[Nominal, ...]:
    """The same for a single joint on a bench."""
    rigid = joint.drive == "rigid"
    inertia, friction = ("motor_inertia", "viscous_friction") if rigid else ("load_inertia", "joint_viscous_drag")
    found = [] if rigid else list(_drive_freedom(load_numbers(), {joint.drive: joint.name}))
    found.append(Nominal(inertia, joint.name, "relative", WIDE))
    if joint.viscous_friction > 0:
        found.append(Nominal(friction, joint.name, "coefficient", WIDE * joint.viscous_friction))
    if joint.gravity_load != 0:
        found.append(Nominal("gravity_load", joint.name, "torque", WIDE * abs(joint.gravity_load)))
    return tuple(found)
