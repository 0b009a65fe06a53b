"""From a bench log of one rigid joint to its evidence: its effects at this joint's sizes, its rows, its floor."""

from collections.abc import Mapping

import numpy as np

from experiments.effects.bench import Scale, bench_effects, sized
from experiments.effects.effect import Effect
from experiments.errors import UserError
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.blocks import BLOCK
from experiments.measurement.evidence.effort_filter import Filter
from experiments.measurement.evidence.joint_evidence import JointEvidence
from experiments.measurement.evidence.joint_lanes import residuals
from experiments.measurement.evidence.joint_replay import STILL, JointLog, JointReplay, corner, raw_rows, rigid_drive
from experiments.measurement.evidence.joint_ripple import with_ripple_seeds
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.noise_floor import estimated
from experiments.model import JointNumbers, Model

MODEL_ERROR = 0.01  # of the RMS effort: what the best model of a real machine leaves; below it nothing is missing
FLOOR_DRAWS = 4


def joint_evidence(log: Log, model: Model, library: Mapping[str, Effect], noise: Mapping[str, float]) -> JointEvidence:
    """Prepare a bench log. Raises UserError where it cannot be judged."""
    joint = model.joint
    if joint is None:
        raise UserError(f"{log.name} is a log of a single joint, but the model is the robot's; give the joint's model.")
    if log.rows * log.sample_period < 4 * BLOCK:
        raise UserError(f"{log.name} is shorter than {4 * BLOCK:g} s; record a longer motion.")
    position, effort = raw_rows(log)
    if np.ptp(position) <= 0:
        raise UserError(f"{log.name}: the joint never moves; record a motion.")
    period = log.sample_period
    noise = _own_noise(log, noise)
    filter_ = Filter(corner(joint.inertia, _rms(effort), noise["joint_position"], period), period)
    own = filter_.log(position, effort)
    speed = np.abs(own.velocity)
    still = STILL * float(speed.max())
    effects = _effects(log, model, library, own, filter_, still)
    atoms = Atoms(tuple(effects.values()), log.joint_names)
    replay = JointReplay(rigid_drive(joint), joint.gravity_load, atoms.active(), period)
    used = (filter_.thinned((speed > still).astype(float)[None])[0] > 0.99) * filter_.inner(log.rows)
    floor = _floor(filter_, replay, atoms, still, position, effort, used, noise)
    return JointEvidence(
        name=log.name,
        atoms=atoms,
        replay=replay,
        log=own,
        filter=filter_,
        rows=log.rows,
        period=period,
        still=still,
        model_x=atoms.placed(atoms.off(), model.effects),
        used=used,
        floor=floor,
        blocks=max(int(log.rows * period / BLOCK), 1),
    )


def _own_noise(log: Log, stated: Mapping[str, float]) -> dict[str, float]:
    """Noise of both signals: what the rows show where that is less than is stated (many drives filter their logs)."""
    found = {}
    for name in ("joint_position", "applied_torque"):
        shown = estimated(log.signals[name].values)
        found[name] = min(shown, stated.get(name, np.inf)) if shown > 0 else stated.get(name, 0.0)
    return found


def _effects(log: Log, model: Model, library, own: JointLog, filter_: Filter, still: float) -> dict[str, Effect]:
    """What may act on this joint, with sizes that its log suggests."""
    joint: JointNumbers = model.joint
    effects = bench_effects(library, joint.kind == "prismatic")
    foreign = [e.effect for e in model.effects if e.effect not in effects]
    if foreign:
        raise UserError(f"The model has the effect {foreign[0]}, which a rigid joint cannot show; remove it.")
    scale = Scale(_rms(own.effort), float(np.ptp(own.position)), float(np.abs(own.velocity).max()))
    effects = sized(effects, library, scale, joint.viscous_friction)
    bare = Atoms((), log.joint_names)
    nominal = JointReplay(rigid_drive(joint), joint.gravity_load, bare.active(), filter_.period)
    left = residuals(nominal, bare, own, still, np.zeros((1, 0)))[0]
    return with_ripple_seeds(effects, own, left, scale.travel, filter_.stride)


def _floor(filter_: Filter, replay, atoms, still: float, position, effort, used, noise: Mapping[str, float]) -> float:
    """RMS of what the sensors' noise and the model of a good machine leave, in the effort's unit."""
    rng, off = np.random.default_rng(0), atoms.off()[None]
    clean = filter_.thinned(residuals(replay, atoms, filter_.log(position, effort), still, off))
    total = 0.0
    for _ in range(FLOOR_DRAWS):
        noisy = filter_.log(
            position + noise["joint_position"] * rng.standard_normal(len(position)),
            effort + noise["applied_torque"] * rng.standard_normal(len(effort)),
        )
        error = filter_.thinned(residuals(replay, atoms, noisy, still, off)) - clean
        total += (error**2 * used).sum() / max(used.sum(), 1.0) / FLOOR_DRAWS
    return float(np.hypot(np.sqrt(total), MODEL_ERROR * _rms(effort)))


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt((np.asarray(x, float) ** 2).mean()))
