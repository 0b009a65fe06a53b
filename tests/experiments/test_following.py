"""Where the nominal numbers go when a hypothesis is tried: to the least chi^2 that their own bounds allow."""

from types import SimpleNamespace

import numpy as np
from scipy.optimize import lsq_linear

from experiments.effects import LIBRARY
from experiments.effects.delay import LOOP_TIMING
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.features import Products, changes_of
from experiments.measurement.fits.nominal import timing
from experiments.measurement.selection.linear_score import Scored, following

ROWS, STRENGTH = 200, 0.004  # N m
ATOMS = Atoms((LIBRARY["coulomb_friction"], LOOP_TIMING), ("axis",))


def test_numbers_follow_a_hypothesis_within_their_own_bounds() -> None:
    changes, variants = changes_of(ATOMS.effects)
    clock = timing(ATOMS.effects)
    columns = np.random.default_rng(1).standard_normal((ROWS, len(changes) + 1))
    effect = 20.0 * STRENGTH / changes[0].step * columns[:, 0]
    phase = next(k for k, c in enumerate(changes) if c.strength == "phase")
    columns[:, -1] += 20.0 * columns[:, phase] - effect  # the log asks for a phase below zero
    columns[:, :-1] *= 20.0
    products = Products((columns.T @ columns)[None], tuple(range(len(changes))), (), np.zeros(len(changes) + 1))
    scored = Scored(LIBRARY["coulomb_friction"], "axis", 0.0, {"torque": STRENGTH}, variants[0])
    fit = SimpleNamespace(nominal=np.zeros(len(clock)))
    found = following([SimpleNamespace(atoms=ATOMS)], [products], fit, clock, changes, scored)

    scale = np.array([n.deviation for n in clock])
    of_clock = [next(k for k, c in enumerate(changes) if c.strength == n.parameter) for n in clock]
    moves = columns[:, of_clock] / [changes[k].step for k in of_clock] * scale
    rest = columns[:, -1] + effect
    low, high = np.array([0.0, -1e-4, -5e-5]) / scale, np.array([5e-4, 1e-4, 1e-4]) / scale
    best = lsq_linear(np.vstack([moves, np.eye(3)]), np.r_[-rest, np.zeros(3)], (low, high))
    np.testing.assert_allclose(found / scale, best.x, atol=1e-6)
    assert found[[n.parameter for n in clock].index("phase")] == 0.0
