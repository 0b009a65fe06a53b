"""From a log to its evidence: the parts of the plant that it measures."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from experiments.effects.bench import GRAVITY_LOAD, elastic_effects
from experiments.effects.delay import LOOP_TIMING
from experiments.effects.effect import Effect
from experiments.effects.link import BEARING_FRICTION
from experiments.errors import UserError
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.blocks import BLOCK
from experiments.measurement.evidence.body_evidence import FEWEST, body_evidence
from experiments.measurement.evidence.body_replay import shows_bodies
from experiments.measurement.evidence.drive_evidence import DriveEvidence, drive_evidence
from experiments.measurement.evidence.drive_log import channels_logged, drive_log, has_drives
from experiments.measurement.evidence.drive_of_bench import drive_of
from experiments.measurement.evidence.joint_of_bench import joint_evidence
from experiments.measurement.evidence.load_evidence import load_evidence
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.evidence.parts import enough
from experiments.measurement.evidence.robot_evidence import RobotEvidence
from experiments.measurement.logs.log import BenchJoint, Log
from experiments.model import JointNumbers, Model
from mjx_starleth.numbers import load_numbers
from sea_jax import params_from_numbers, periods_from_numbers
from sea_jax.parameters import select_joints


def model_for(log: Log, model: Model) -> Model:
    """The model given; for a log of a joint on a bench and the robot's model, the numbers in the log's own JSON."""
    if log.joint is None or model.joint is not None:
        return model
    known = log.joint.model_dump(include=set(JointNumbers.model_fields))
    joint = JointNumbers(**known | {"drive": drive_of(log)})
    return Model(robot="joint", joint=joint)


def refuse_different_joints(logs: Sequence[Log]) -> None:
    """Logs that are judged together share one model, and so one robot or one joint. Raises UserError."""
    told = [None if log.joint is None else log.joint.model_dump(include=set(BenchJoint.model_fields)) for log in logs]
    for log, its in zip(logs, told, strict=True):
        if its != told[0]:
            raise UserError(
                f"{log.name} is of another robot or joint than {logs[0].name}, by their JSON; judge them apart."
            )


def library_for(model: Model, library: Mapping[str, Effect]) -> dict[str, Effect]:
    """The effects that can be told on this model's logs; those of the load come with a bench joint alone."""
    if model.joint is None:
        return dict(library)
    if model.joint.drive != "rigid":
        return elastic_effects(library)
    return dict(library) | {GRAVITY_LOAD.name: GRAVITY_LOAD}


def gather(log: Log, model: Model, effects: Mapping[str, Effect], noise: Mapping[str, float]) -> Evidence:
    """Everything that a log says; the model's own effects are among `effects`. Raises UserError."""
    if log.robot == "joint" and (model.joint is None or model.joint.drive == "rigid"):
        return joint_evidence(log, model, effects, noise)
    if log.rows * log.sample_period < BLOCK:
        raise UserError(f"{log.name} is shorter than {BLOCK:g} s, too short to be judged; record a longer motion.")
    if log.robot == "joint":
        return _elastic_joint(log, model, effects, noise)
    if model.numbers is None:
        raise UserError(f"{log.name} is a log of the robot, but the model is a single joint.")
    numbers = model.numbers.model_dump(mode="json")
    effects = {BEARING_FRICTION.name: BEARING_FRICTION, **effects}  # free in every fit
    atoms = Atoms((*effects.values(), LOOP_TIMING), log.joint_names)
    drive = body = None
    if has_drives(log):
        params, periods = params_from_numbers(numbers), periods_from_numbers(numbers)
        drive = _shown(drive_evidence(atoms, params, periods, drive_log(log), log.sample_period, noise), log)
    if shows_bodies(log):
        body = body_evidence(atoms, model.numbers, log, noise)
    if drive is None and body is None:
        raise UserError(
            f"{log.name} shows neither drives (commands and motor positions) nor bodies (joint torques and, on the "
            "ground, the torso's position and orientation): log them."
        )
    return _evidence(log, model, atoms, drive, body)


def _elastic_joint(log: Log, model: Model, effects: Mapping[str, Effect], noise: Mapping[str, float]) -> Evidence:
    """A bench log of a joint on one of the robot's drives."""
    numbers = load_numbers().model_dump(mode="json")
    params = select_joints(params_from_numbers(numbers), [numbers["joints"].index(model.joint.drive)])
    atoms, table = Atoms((*effects.values(), LOOP_TIMING), log.joint_names), drive_log(log)
    drive = drive_evidence(atoms, params, periods_from_numbers(numbers), table, log.sample_period, noise)
    load = load_evidence(atoms, model.joint, table, log.sample_period, noise)
    return _evidence(log, model, atoms, _shown(drive, log), load)


def _shown(drive: DriveEvidence, log: Log) -> DriveEvidence:
    """Only what the log tells of each joint counts."""
    return replace(drive, used=drive.used * channels_logged(log))


def _evidence(log: Log, model: Model, atoms: Atoms, drive, body) -> Evidence:
    tells = drive is not None and drive.used.any()
    if not tells and (body is None or not enough(body.channels, body.used.sum(0), FEWEST).any()):
        raise UserError(f"{log.name}: no channel has rows enough to be judged; record a longer or calmer motion.")
    blocks = max(int(log.rows * log.sample_period / BLOCK), 1)
    x = atoms.placed(atoms.off(), model.effects)
    return RobotEvidence(log.name, atoms, drive, body, blocks, log.sample_period, x)
