"""The diagnosis and, in the same harness, what one would do without it. Each answers with a part of the answer file.

- parameters: fit the robot's nominal numbers, name those that moved most
- best_single: fit every effect alone to the whole log, take the best
- sparse: sequentially thresholded least squares on all linear features at once (as SINDy does)
- removed: the diagnosis itself, with a library that lacks the true effect
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments.effects.effect import Effect
from experiments.effects.places import mask
from experiments.measurement.diagnose import diagnose_evidence
from experiments.measurement.evidence.features import changes_of
from experiments.measurement.evidence.gather import gather
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.fits.fit_types import Placed
from experiments.measurement.fits.nominal import nominal_freedom
from experiments.measurement.fits.refit import refit
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.noise_floor import noise_of
from experiments.measurement.selection.linear_score import best_of_each, score
from experiments.model import Model

Answer = dict[str, Any]
MOVED = 1.0  # prior deviations from which a nominal number is named
CANDIDATES = 5
SMALL = 0.1  # of the largest contribution: smaller ones are thresholded away
ROUNDS = 10
RIDGE = 1e-6


def answers(
    log: Log, model: Model, library: Mapping[str, Effect], truth: Sequence[str], methods: Sequence[str]
) -> dict[str, Answer]:
    """The answers of these METHODS to one log; `truth`, the hidden effects' names, serves `removed` alone."""
    silent = lambda text: None  # noqa: E731
    found: dict[str, Answer] = {}
    if set(methods) - {"removed"}:
        evidence = gather(log, model, library, noise_of(log))
        asked = {
            "diagnosis": lambda: diagnose_evidence((evidence,), model, silent).answer,
            "parameters": lambda: parameters(evidence, model),
            "best_single": lambda: best_single(evidence),
            "sparse": lambda: sparse(evidence),
        }
        found = {name: ask() for name, ask in asked.items() if name in methods}
    if "removed" in methods and len(truth) == 1 and truth[0] in library:
        fewer = {name: effect for name, effect in library.items() if name != truth[0]}
        without = gather(log, model, fewer, noise_of(log))
        found["removed"] = diagnose_evidence((without,), model, silent).answer
    return found


def parameters(log: Evidence, model: Model) -> Answer:
    """Nominal numbers only."""
    nominal = nominal_freedom(model, log.atoms.effects, log.standing)
    fit = refit([log], (), nominal)
    moved = sorted(zip(nominal, fit.nominal, strict=True), key=lambda pair: -abs(pair[1]) / pair[0].deviation)
    named = [n for n, value in moved if abs(value) > MOVED * n.deviation]
    return _answer([(n.effect, n.where) for n in named])


def best_single(log: Evidence) -> Answer:
    """The single effect that fits the whole log best, with no proof."""
    fit = refit([log], (), (), iterations=3)
    changes, variants = changes_of(log.atoms.effects, [log], fit.points)
    candidates = best_of_each(score([log], fit, (), changes, variants))[:CANDIDATES]
    fits = [refit([log], [Placed(s.effect.name, s.where, s.values)], (), fit) for s in candidates if s.gain > 0]
    if not fits:
        return _answer([])
    best = min(fits, key=lambda f: f.total)
    return _answer([(p.effect, p.where) for p in best.effects])


def sparse(log: Evidence) -> Answer:
    """Thresholded least squares on the features of all effects at all places."""
    fit = refit([log], (), (), iterations=3)
    changes, variants = changes_of(log.atoms.effects, [log], fit.points)
    products = log.products(fit.points[0], changes)
    gram = products.gram.sum(0)
    names, columns = [], []
    for variant in variants:
        for where in log.atoms.places(variant.effect):
            place = mask(where, variant.effect.axis, log.atoms.joint_names)
            direction = products.direction(log.atoms, variant, changes, place)
            names += [(variant.effect.name, where)] * direction.shape[1]
            columns += list(direction.T)
    d = np.stack(columns, 1)
    h, g = d.T @ gram @ d, -(gram[-1] @ d)
    size = np.sqrt(np.diag(h))
    alive = np.flatnonzero(size > 1e-9 * size.max())
    weight = np.zeros(0)
    for _ in range(ROUNDS):
        inner = h[np.ix_(alive, alive)] / np.outer(size[alive], size[alive]) + RIDGE * np.eye(len(alive))
        weight = np.linalg.solve(inner, g[alive] / size[alive])
        kept = np.abs(weight) > SMALL * np.abs(weight).max()
        if kept.all():
            break
        alive, weight = alive[kept], weight[kept]
    order = alive[np.argsort(-np.abs(weight))]
    return _answer(list(dict.fromkeys(names[i] for i in order)))


def _answer(named: list[tuple[str, str]]) -> Answer:
    effects = [{"effect": effect, "where": where, "parameters": {}} for effect, where in named]
    return {"verdict": "explained" if named else "none", "effects": effects}


METHODS = ("diagnosis", "parameters", "best_single", "sparse", "removed")
