"""Below the floor: what noise in the links' motion adds to a score, and when an effect stands alone without it."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.measurement.evidence import unbiased
from experiments.measurement.evidence.features import Products
from experiments.measurement.evidence.log_evidence import Point
from experiments.measurement.evidence.unbiased import unbiased_products
from experiments.measurement.selection import lone as module
from experiments.measurement.selection.finalists import Round
from experiments.measurement.selection.linear_score import Scored
from experiments.measurement.selection.lone import lone
from mjx_starleth.names import JOINT_NAMES

ROWS, NOISE, GAIN = 20000, 0.5, 3.0
POINT = Point(np.zeros(1), np.zeros(1), np.zeros(0))


@dataclass(frozen=True)
class Spring:
    """Its torque, GAIN times a motion that the log holds with noise."""

    motion: np.ndarray
    renoised: tuple[np.ndarray, ...]
    torque: np.ndarray


@dataclass(frozen=True)
class OneSpring:
    drive: Spring

    def products(self, at: Point, changes: list) -> Products:
        columns = np.stack([self.drive.motion, GAIN * self.drive.motion - self.drive.torque])
        return Products((columns @ columns.T)[None], (0,), (), np.zeros(2))


def noise_alone(rows: int) -> OneSpring:
    first, again = np.random.default_rng(2).standard_normal((2, rows))
    return OneSpring(Spring(first, (first + again,), np.zeros(rows)))


@pytest.fixture(autouse=True)
def every_row_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unbiased, "without_untold", lambda log, at: log)


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_the_links_own_noise_is_taken_out_of_what_a_feature_and_the_residual_have_in_common(missing: float) -> None:
    rng = np.random.default_rng(1)
    true, first, again = np.sin(np.arange(ROWS) / 50.0), *(NOISE * rng.standard_normal((2, ROWS)))
    log = OneSpring(Spring(true + first, (true + first + again,), (GAIN + missing) * true))
    common = log.products(POINT, []).gram[0, -1, 0] / ROWS
    assert common == pytest.approx(GAIN * NOISE**2 - missing / 2.0, abs=0.03)  # E[(m + e)(G (m + e) - (G + d) m)]
    without = unbiased_products(log, POINT, [], log.products(POINT, [])).gram[0]
    assert without[-1, 0] / ROWS == without[0, -1] / ROWS == pytest.approx(-missing / 2.0, abs=0.05)


def test_a_feature_of_noise_alone_keeps_its_size() -> None:
    """What divides by next to nothing finds large effects."""
    log = noise_alone(ROWS)
    own, found = log.products(POINT, []), unbiased_products(log, POINT, [], log.products(POINT, []))
    assert (found.gram.diagonal(0, 1, 2) == own.gram.diagonal(0, 1, 2)).all()


def test_rows_that_noise_decides_are_in_none_of_the_products(monkeypatch: pytest.MonkeyPatch) -> None:
    log, told = noise_alone(ROWS), noise_alone(ROWS // 2)
    expected = unbiased_products(told, POINT, [], told.products(POINT, []))
    monkeypatch.setattr(unbiased, "without_untold", lambda log, at: told)
    np.testing.assert_array_equal(unbiased_products(log, POINT, [], log.products(POINT, [])).gram, expected.gram)


def test_bodies_alone_have_their_own_calm_log() -> None:
    own = Products(np.ones((1, 2, 2)), (0,), (), np.zeros(2))
    assert unbiased_products(SimpleNamespace(drive=None), POINT, [], own) is own


def found(
    monkeypatch: pytest.MonkeyPatch, *scores: tuple[str, str, float, float], noise: float = 3000.0, **at: float
) -> list[str]:
    """Of effects at places, with their scores as they are and without noise's share: those that are sought."""
    variants = [SimpleNamespace(effect=LIBRARY[name]) for name, *_ in scores]
    as_is = [Scored(LIBRARY[n], where, gain, {}, v) for (n, where, gain, _), v in zip(scores, variants, strict=True)]
    less = [one._replace(gain=s[3]) for one, s in zip(as_is, scores, strict=True)]
    monkeypatch.setattr(module, "unbiased_products", lambda log, at, changes, own: own)
    monkeypatch.setattr(module, "scored_at", lambda *_: less)
    monkeypatch.setattr(module, "noise_at", lambda effect, where, *_: at.get(where, noise))
    log = SimpleNamespace(atoms=SimpleNamespace(joint_names=JOINT_NAMES), blocks=1)
    round_ = Round([log], (), [], [None], [], [], lambda text: None)
    ranking = sorted(as_is, key=lambda s: -s.gain)
    return [s.effect.name for s in lone([log], SimpleNamespace(points=[POINT]), ranking, round_)]


def test_noise_that_looks_like_play_in_the_knees_hides_no_drag(monkeypatch) -> None:
    play, drag = ("backlash", "KFE", 208.0, 20.0), ("joint_coulomb_drag", "RF_HAA", 181.0, 181.0)
    assert found(monkeypatch, play, drag) == ["joint_coulomb_drag"]
    assert found(monkeypatch, play, drag, KFE=12000.0) == ["joint_coulomb_drag"]
    assert found(monkeypatch, play, drag, RF_HAA=12000.0) == []
    assert found(monkeypatch, play) == []


def test_what_less_noise_would_make_larger_is_no_effect(monkeypatch) -> None:
    assert found(monkeypatch, ("load_friction", "LF_KFE", 143.0, 505.0), ("torque_ripple", "RH_HFE", 90.0, 90.0)) == []
    assert found(monkeypatch, ("load_friction", "LF_KFE", 143.0, 505.0), ("payload", "torso", 160.0, 160.0)) == []


def test_a_score_that_noise_alone_reaches_is_no_effect_however_quiet_the_place(monkeypatch) -> None:
    assert found(monkeypatch, ("spring_stiffness", "RH_KFE", 120.0, 120.0), noise=100.0) == []
    assert found(monkeypatch, ("spring_stiffness", "RH_KFE", 200.0, 120.0), noise=100.0) == []


def test_an_effect_is_alone_though_another_at_its_place_explains_as_much_and_both_are_refitted(monkeypatch) -> None:
    offset = ("torque_sensor_offset", "RH_HAA", 556.0, 556.0)
    alike, less = ("direction_dependent_friction", "RH_HAA", 544.0, 544.0), ("backlash", "RH_HAA", 100.0, 100.0)
    assert found(monkeypatch, offset, alike, less) == ["torque_sensor_offset", "direction_dependent_friction"]
    half = ("backlash", "RH_HAA", 278.0, 278.0)
    assert found(monkeypatch, offset, half) == ["torque_sensor_offset", "backlash"]
    assert found(monkeypatch, offset, ("direction_dependent_friction", "LF_HAA", 300.0, 300.0)) == []
    far_less = ("direction_dependent_friction", "LF_HAA", 130.0, 130.0)
    assert found(monkeypatch, offset, far_less) == ["torque_sensor_offset"]
    assert found(monkeypatch, offset, ("ground_friction", "feet", 300.0, 300.0)) == []


def test_a_score_has_to_be_something_beside_the_noise_where_it_acts_unless_it_is_large(monkeypatch) -> None:
    spring, ripple = ("spring_stiffness", "RH_KFE", 182.0, 182.0), ("torque_ripple", "HAA", 799.0, 799.0)
    assert found(monkeypatch, spring, noise=8700.0) == []
    assert found(monkeypatch, spring, noise=5000.0) == ["spring_stiffness"]
    assert found(monkeypatch, ripple, noise=38000.0) == ["torque_ripple"]
    assert found(monkeypatch, ("torque_ripple", "HAA", 600.0, 600.0), noise=38000.0) == []
