"""The refit's least squares on a log that is a formula: it finds what it should, and survives what is no number."""

import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.log_evidence import Point
from experiments.measurement.evidence.robot_evidence import RobotEvidence
from experiments.measurement.fits.fit_types import Nominal, Placed
from experiments.measurement.fits.misfit import misfit
from experiments.measurement.fits.refit import BLOWN_UP, refit, refit_effects
from experiments.measurement.selection.belief import COVERAGE

HIDDEN = 40.0  # N m/rad^3
BLOCKS = 4


class Formula:
    """Stands for an `Evidence`: one residual a block, (cubic - HIDDEN); no number beyond `bursts`."""

    name, blocks = "formula", BLOCKS
    atoms = Atoms((LIBRARY["spring_stiffening"],), ("axis",))

    def __init__(self, bursts: float):
        self.bursts = bursts

    def start(self) -> Point:
        return Point(np.zeros(1), np.zeros(1), np.zeros(0))

    def residual(self, x: np.ndarray) -> float:
        return x[0] - HIDDEN if x[0] < self.bursts else np.nan

    def chi2(self, points: list[Point]) -> np.ndarray:
        return np.array([[self.residual(p.x) ** 2] * BLOCKS for p in points])

    def weight(self) -> np.ndarray:
        return np.ones(self.blocks)

    def local(self, at: Point, directions: np.ndarray) -> np.ndarray:
        here = self.residual(at.x)
        row = np.array([*(self.residual(at.x + d) - here for d in directions), 0.0, here])  # one shift, without effect
        return np.repeat(np.outer(row, row)[None], BLOCKS, 0)

    def constant_errors(self, at: Point) -> np.ndarray:
        return np.zeros((self.blocks, 0))

    def coefficients(self, at: Point) -> np.ndarray:
        return at.shift

    def nuisances(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return z, np.zeros(0)


def fitted(start: float, bursts: float):
    return refit([Formula(bursts)], [Placed("spring_stiffening", "axis", {"cubic": start})], ())


@pytest.mark.parametrize("start", [5.0, 90.0])
def test_a_strength_is_found_from_either_side(start: float) -> None:
    found = fitted(start, np.inf)
    assert found.effects[0].parameters["cubic"] == pytest.approx(HIDDEN, abs=1e-3) and found.total < 1e-3


def test_an_effect_that_makes_the_replay_no_number_explains_nothing_and_raises_nothing() -> None:
    found = fitted(90.0, bursts=60.0)
    assert found.total == BLOCKS * BLOWN_UP and np.isfinite(found.covariance).all()
    assert fitted(5.0, bursts=60.0).effects[0].parameters["cubic"] == pytest.approx(HIDDEN, abs=1e-3)


def test_an_effect_whose_linear_score_overshoots_is_found_from_less() -> None:
    log, too_strong = Formula(bursts=60.0), [Placed("spring_stiffening", "axis", {"cubic": 90.0})]
    held = refit([log], (), ())
    found = refit_effects([log], too_strong, (), held, [np.ones(BLOCKS, bool)], 4)
    assert found.effects[0].parameters["cubic"] == pytest.approx(HIDDEN, abs=1e-3)


def test_a_number_that_an_effect_stands_for_stays_nominal() -> None:
    log, number = Formula(bursts=np.inf), Nominal("spring_stiffening", "axis", "cubic", 20.0)
    (alone,) = refit([log], (), [number]).nominal
    found = refit([log], [Placed("spring_stiffening", "axis", {"cubic": 5.0})], [number])
    assert alone == pytest.approx(HIDDEN, rel=0.01)
    assert abs(found.nominal[0]) < 1e-3 and found.effects[0].parameters["cubic"] == pytest.approx(HIDDEN, abs=1e-3)


class Bent(Formula):
    """The residual turns round: a linear step from afar goes far beyond."""

    def residual(self, x: np.ndarray) -> float:
        return 10.0 * np.arctan(x[0] - HIDDEN)


def test_a_step_that_goes_too_far_is_damped_until_it_goes_down() -> None:
    found = refit([Bent(np.inf)], [Placed("spring_stiffening", "axis", {"cubic": 90.0})], ())
    assert found.effects[0].parameters["cubic"] == pytest.approx(HIDDEN, abs=2.0)


class Counted(Formula):
    """Counts its local products; beside the residual stands a rest that nothing explains."""

    def __init__(self, rest: float):
        super().__init__(np.inf)
        self.rest, self.asked = rest, 0

    def residual(self, x: np.ndarray) -> float:
        return 10.0 * np.arctan(0.05 * (x[0] - HIDDEN))

    def chi2(self, points: list[Point]) -> np.ndarray:
        return super().chi2(points) + self.rest

    def local(self, at: Point, directions: np.ndarray) -> np.ndarray:
        self.asked += 1
        return super().local(at, directions)


def test_a_fit_ends_sooner_where_what_it_could_gain_is_next_to_nothing_of_what_it_leaves() -> None:
    small, large = Counted(rest=0.0), Counted(rest=1e7)
    for log in (small, large):
        refit([log], [Placed("spring_stiffening", "axis", {"cubic": 55.0})], ())
    assert small.asked > 2 and large.asked == 1


def test_a_fit_that_stands_where_it_should_asks_once() -> None:
    log = Counted(rest=0.0)
    found = refit([log], [Placed("spring_stiffening", "axis", {"cubic": HIDDEN})], ())
    assert log.asked == 1 and found.covariance[0, 0] > 0


@pytest.mark.parametrize(("start", "hidden"), [(HIDDEN, HIDDEN), (20_000.0, 21_000.0)], ids=["found", "beyond its end"])
def test_a_fit_that_cannot_gain_anything_tries_no_more(start: float, hidden: float) -> None:
    log = Counted(rest=0.0)
    log.residual = lambda x: x[0] - hidden
    tried = []
    log.chi2 = lambda points: tried.append(points) or Formula.chi2(log, points)
    found = refit([log], [Placed("spring_stiffening", "axis", {"cubic": start})], ())
    assert found.effects[0].parameters["cubic"] == start and len(tried) == 3  # at first, one step, and what it is then


class Pushed:
    """Stands for the bodies of a log: one channel with the same residual on all rows, which should be off by half."""

    channels, model_error, floor, tau = ("torso_force/x",), np.array([0.5]), np.ones(1), np.ones(1)
    used = np.ones((200, 1))

    def __init__(self, constant: float):
        self.constant = constant

    def residual(self, xs: np.ndarray) -> np.ndarray:
        return np.full((len(xs), 200, 1), self.constant)


@pytest.mark.parametrize("constant", [0.5, 2.0, -10.0])
def test_a_constant_error_costs_what_it_is_unlikely_for_the_model(constant: float) -> None:
    log = RobotEvidence("log", Formula.atoms, None, Pushed(constant), BLOCKS, 0.0025, np.zeros(1))
    fit = refit([log], (), ())
    assert fit.total == pytest.approx((constant / 0.5) ** 2, rel=0.05)  # of 200 rows: else 200 constant^2
    assert misfit(log, fit, 0).worst == pytest.approx(abs(constant / 0.5) / np.sqrt(200), rel=0.05)


class Linear(Formula):
    """A log whose residual is linear in the numbers of many joints; its noise is alike for all of a block."""

    blocks, rows = 16, 40
    names = tuple(f"joint{i}" for i in range(25))
    atoms = Atoms((LIBRARY["spring_stiffening"],), names)

    def __init__(self, rng: np.random.Generator):
        self.features = rng.normal(size=(self.blocks, self.rows, len(self.names))) / 20.0
        coloured = rng.normal(size=(self.blocks, 1)) * np.sign(self.features[..., 0])
        self.noise = rng.normal(size=(self.blocks, self.rows)) + coloured

    def start(self) -> Point:
        return Point(np.zeros(len(self.names)), np.zeros(1), np.zeros(0))

    def weight(self) -> np.ndarray:
        return np.full(self.blocks, float(self.rows))

    def rows_at(self, x: np.ndarray) -> np.ndarray:
        return self.features @ (x - HIDDEN * (np.arange(len(x)) == 0)) + self.noise

    def chi2(self, points: list[Point]) -> np.ndarray:
        return np.array([(self.rows_at(p.x) ** 2).sum(1) for p in points])

    def local(self, at: Point, directions: np.ndarray) -> np.ndarray:
        moved = np.einsum("brn,dn->brd", self.features, directions)
        columns = np.concatenate([moved, np.zeros((self.blocks, self.rows, 1)), self.rows_at(at.x)[..., None]], 2)
        return np.einsum("bri,brj->bij", columns, columns)


def test_intervals_hold_under_coloured_residuals_with_more_numbers_than_blocks() -> None:
    """What comes out of 100 logs is the oracle: the interval holds the truth, and is no wider than it has to be."""
    effect = Placed("spring_stiffening", "joint0", {"cubic": 30.0})
    numbers = [Nominal("spring_stiffening", name, "cubic", 2.0) for name in Linear.names[1:]]
    found = []
    for seed in range(100):
        fit = refit([Linear(np.random.default_rng(seed))], [effect], numbers)
        found.append((fit.effects[0].parameters["cubic"] - HIDDEN, fit.covariance[0, 0] ** 0.5))
    error, spread = np.array(found).T
    assert 0.9 <= np.mean(np.abs(error) <= COVERAGE * spread) <= 0.99
    assert 0.9 <= np.median(spread) / error.std() <= 1.4
