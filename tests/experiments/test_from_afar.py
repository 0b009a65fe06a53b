"""Where a sharp effect's fit begins: at the least absolute residuals, wherever a few rows far off would have it."""

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.log_evidence import Point
from experiments.measurement.fits.fit_types import Placed, Refitted
from experiments.measurement.fits.from_afar import MULTIPLES, from_afar

ROWS, HIDDEN = 200, 0.02  # rad of play
PART = SimpleNamespace(tau=1.0)


class Formula:
    """Stands for an `Evidence`: all rows tell the play, but a few, far off, are quiet at a smaller one only."""

    blocks = 1
    atoms = Atoms((LIBRARY["backlash"], LIBRARY["spring_stiffness"]), ("axis",))

    def start(self) -> Point:
        return Point(np.zeros(self.atoms.size), np.zeros(1), np.zeros(0))

    def residual(self, x: np.ndarray) -> np.ndarray:
        play = x[self.atoms.of("backlash")[0].start]
        far = 100.0 * (abs(play - 0.5 * HIDDEN) > 0.1 * HIDDEN)
        softer = x[self.atoms.of("spring_stiffness")[0].start]  # would fit better at 0.2
        return np.where(np.arange(ROWS) < 4, far, 1000.0 * (play - HIDDEN) + 0.1 * abs(softer - 0.2))

    def chi2(self, points: list[Point]) -> np.ndarray:
        return np.array([[(self.residual(p.x) ** 2).sum()] for p in points])

    def rests(self, point: Point) -> tuple[SimpleNamespace, ...]:
        return (SimpleNamespace(residual=self.residual(point.x), part=PART),)

    def coefficients(self, at: Point) -> np.ndarray:
        return np.zeros(1)


def fit_of(*effects: Placed) -> Refitted:
    return Refitted(effects, np.zeros(0), np.zeros(0), (Formula().start(),), (np.zeros(1),), np.zeros((0, 0)))


def test_few_rows_far_off_do_not_decide_where_a_sharp_effect_begins() -> None:
    stiffer = Placed("spring_stiffness", "axis", {"relative": 0.1})
    found = from_afar([Formula()], fit_of(Placed("backlash", "axis", {"half_width": 0.5 * HIDDEN}), stiffer), ())
    assert found[0].parameters["half_width"] == pytest.approx(HIDDEN, rel=MULTIPLES[1] / MULTIPLES[0] - 1.0)
    assert found[1] == stiffer  # it is not sharp


def test_where_all_rows_agree_it_begins_where_it_was() -> None:
    placed = Placed("backlash", "axis", {"half_width": HIDDEN})
    assert from_afar([Formula()], fit_of(placed), ()) == [placed]
