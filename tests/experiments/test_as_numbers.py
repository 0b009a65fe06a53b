"""A selection made over, with effects that may be nominal numbers as such numbers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.measurement.fits.fit_types import Nominal, Placed, Refitted
from experiments.measurement.selection import as_numbers as module
from experiments.measurement.selection.as_numbers import as_numbers
from experiments.measurement.selection.elsewhere import Elsewhere
from experiments.measurement.selection.ladder import Rung, Selection

LOGS = (SimpleNamespace(atoms=SimpleNamespace(effects=tuple(LIBRARY.values()))),)
NOMINAL = tuple(Nominal("motor_inertia", kind, "relative", 0.06) for kind in ("HAA", "HFE", "KFE"))
PHASE = Nominal("loop_timing", "all", "phase", 2.5e-4)
INERTIA = Placed("motor_inertia", "KFE", {"relative": -0.09})
SAG = Placed("bus_voltage_sag", "all", {"resistance": 2.0, "switching": 1.0})
GAIN = Placed("torque_sensor_gain", "all", {"relative": 0.05})


def fit(*effects: Placed, nominal: tuple[float, ...] = ()) -> Refitted:
    return Refitted(effects, np.array(nominal), np.zeros(len(nominal)), (), (), np.zeros((0, 0)))


def found(*effects: Placed) -> Selection:
    """A selection of these effects, with the loops' phase as its only free number."""
    rungs = [Rung(f"rung {k}", fit(*effects[:k]), fit()) for k in range(len(effects) + 1)]
    ties = [[(p.effect, p.where)] for p in effects]
    kept = {"ties": ties, "winners": [None] * len(ties), "rivals": [[]] * len(ties), "sure": [True] * len(ties)}
    asked = {"rankings": [["a ranking"]], "refitted": [["a finalist"]], "refuted": ["a log"]}
    return Selection(fit(*effects, nominal=(1e-4,)), (PHASE,), Elsewhere((), ()), ladder=rungs, **kept, **asked)


@pytest.fixture
def starts(monkeypatch: pytest.MonkeyPatch) -> list[tuple[tuple[Placed, ...], np.ndarray]]:
    """The effects and the nominal numbers that each fit to all blocks starts from; fits stay where they start."""
    asked = []

    def refit(logs, effects, nominal, start, blocks=None, iterations=0):
        if blocks is None:
            asked.append((effects, start.nominal))
        return replace(start, effects=effects)

    for name in ("take_out_needless", "take_out_idle"):
        monkeypatch.setattr(module, name, lambda *_: None)
    monkeypatch.setattr(module, "halves", lambda _: ([], []))
    monkeypatch.setattr(module, "refit", refit)
    return asked


def test_effects_within_a_numbers_reach_become_that_number_and_the_others_stay(starts) -> None:
    freedom = (PHASE, *NOMINAL)
    made_over = as_numbers(LOGS, found(INERTIA, SAG, GAIN), freedom, fit(nominal=(0.0,) * 4))
    assert made_over.fit.effects == (SAG, GAIN)
    assert made_over.ties == [[("bus_voltage_sag", "all")], [("torque_sensor_gain", "all")]]
    assert [rung.name for rung in made_over.ladder] == ["rung 0", "rung 2", "rung 3"]
    np.testing.assert_allclose(made_over.fit.nominal, [1e-4, 0.0, 0.0, -0.09])


def test_what_was_asked_on_the_way_stays_known(starts) -> None:
    was = found(INERTIA, SAG)
    made_over = as_numbers(LOGS, was, (PHASE, *NOMINAL), fit(nominal=(0.0,) * 4))
    assert (made_over.rankings, made_over.refitted, made_over.refuted) == (was.rankings, was.refitted, was.refuted)


def test_each_fit_starts_from_the_numbers_as_they_were_found(starts) -> None:
    as_numbers(LOGS, found(INERTIA, SAG, GAIN), (PHASE, *NOMINAL), fit(nominal=(0.0,) * 4))
    assert [effects for effects, _ in starts] == [(SAG,), (SAG, GAIN)]
    for _, nominal in starts:
        np.testing.assert_allclose(nominal, [1e-4, 0.0, 0.0, -0.09])


@pytest.mark.parametrize("effects", [(SAG, GAIN), (INERTIA, GAIN), (INERTIA,), (INERTIA._replace(where="LH"), SAG)])
def test_without_a_number_or_a_sharp_effect_beside_it_there_is_nothing_to_make_over(starts, effects) -> None:
    freedom = (PHASE, *NOMINAL)
    assert as_numbers(LOGS, found(*effects), freedom, fit(nominal=(0.0,) * 4)) is None
    assert starts == []
