"""From a log to its evidence: the parts of the plant that it measures."""

from collections.abc import Mapping

from experiments.effects.delay import LOOP_LAG
from experiments.effects.effect import Effect
from experiments.errors import UserError
from experiments.measurement.atoms import Atoms
from experiments.measurement.body_evidence import body_evidence
from experiments.measurement.drive_evidence import drive_evidence
from experiments.measurement.drive_log import drive_log, has_drives
from experiments.measurement.evidence import BLOCK, Evidence
from experiments.measurement.joint_evidence import JointEvidence, joint_evidence
from experiments.measurement.log import Log
from experiments.model import JointNumbers, Model
from mjx_starleth.bodies import make_bodies
from sea_jax import params_from_numbers, periods_from_numbers


def model_for(log: Log, model: Model) -> Model:
    """The model given; for a log of a joint on a bench and the robot's model, the numbers in the log's own JSON."""
    if log.joint is None or model.joint is not None:
        return model
    gravity = log.joint.further_numbers.get("gravity_load", 0.0)
    joint = JointNumbers(**log.joint.model_dump(include=set(JointNumbers.model_fields)) | {"gravity_load": gravity})
    return Model(robot="joint", joint=joint)


def gather(
    log: Log, model: Model, effects: Mapping[str, Effect], noise: Mapping[str, float]
) -> Evidence | JointEvidence:
    """Everything that a log says; the model's own effects are among `effects`. Raises UserError."""
    if log.robot == "joint":
        return joint_evidence(log, model, effects, noise)
    if model.numbers is None:
        raise UserError(f"{log.name} is a log of the robot, but the model is a single joint.")
    numbers = model.numbers.model_dump(mode="json")
    atoms = Atoms((*effects.values(), LOOP_LAG), log.joint_names)
    blocks = max(int(log.rows * log.sample_period / BLOCK), 1)
    drive = body = None
    if has_drives(log):
        params, periods = params_from_numbers(numbers), periods_from_numbers(numbers)
        drive = drive_evidence(atoms, params, periods, drive_log(log), log.sample_period, noise)
    if log.joints("joint_torque") is not None:
        bodies = make_bodies(model.numbers)
        body = body_evidence(atoms, bodies, bodies.params, log, noise)
    if drive is None and body is None:
        raise UserError(f"{log.name} shows neither drives (commands and motor positions) nor joint torques: log them.")
    return Evidence(log.name, atoms, drive, body, blocks, log.sample_period, atoms.placed(atoms.off(), model.effects))
