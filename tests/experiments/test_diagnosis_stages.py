"""Which stages a diagnosis goes through: with the nominal numbers as they stand, and with numbers a little off."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from experiments.effects import LIBRARY
from experiments.measurement import diagnose as diagnosis
from experiments.measurement.evidence.features import changes_of
from experiments.measurement.fits.fit_types import Placed
from experiments.measurement.selection import stages as module
from experiments.measurement.selection.belief import LEAST_GAIN
from experiments.measurement.selection.judged_rows import Judged
from experiments.measurement.selection.ladder import Selection
from experiments.measurement.selection.select import NOISE
from experiments.measurement.selection.stages import LITTLE, ROUGH, SEVERAL, WELL_EXPLAINED
from experiments.measurement.selection.steadiness import _states_of

TOLD = (Placed("bus_voltage_sag", "all", {"resistance": 2.5, "switching": 1.0}),)


def stages(
    monkeypatch: pytest.MonkeyPatch,
    excess: float,
    above: float,
    told: tuple | None = None,
    left: float = 1.0,
    finds: tuple[int, float] | None = None,
    effects: int = 1,
    kept: float | None = None,
    inexact: bool = False,
) -> list[tuple[int, float]]:
    """Effects sought at most, and the excess they are sought down to, stage by stage; none explains anything.

    told: the logs without rows that no replay tells; left: the share of the misfit that their effects leave; finds: the
    stage that finds an effect; effects: how many those with the nominal numbers find; kept: the excess that some of
    them leave where the others are taken as numbers; inexact: whether effects are no larger than numbers are exact.
    """
    calls = []

    def select(logs, nominal, say, most=6, least=NOISE, promising=0.0, begun=None, start=None, begin=()):
        assert bool(begin) == (logs is told and most > 0)  # without rows, from the effects that told which
        calls.append((most, least))
        found = ("backlash",) * effects if promising or (most, least) == finds else ()
        fit = SimpleNamespace(effects=found, nominal=())
        return Selection(fit, (), None, [SimpleNamespace(fit=None)])

    stubs = {"select": select, "refit": lambda *_: None, "as_far_as_others": lambda freedom, _: freedom}
    stubs |= {"at_end": lambda *_: (), "nominal_freedom": lambda *_: (), "never_given": lambda *_: ()}
    stubs |= {"numbers_among": lambda found, _: tuple(found), "all_inexact": lambda *_: inexact}
    stubs |= {
        "above_floor": lambda *_: above,
        "leaves_more": lambda *_: above > LEAST_GAIN,
        "judged_rows": lambda *_: None if told is None else Judged(told, TOLD),
        "unexplained": lambda *_: left,
        "excess": lambda _, fit: kept if fit == "kept" else excess if len(calls) < 2 else excess / 2.0,
        "as_numbers": lambda *_: None if kept is None else SimpleNamespace(fit="kept"),
    }
    for name, stub in stubs.items():
        monkeypatch.setattr(module, name, stub)
    log = SimpleNamespace(standing=True, rigid=False, atoms=SimpleNamespace(effects=()))
    module.selected((log,), None, lambda _: None)
    return calls


def test_in_a_log_that_the_nominal_model_explains_only_an_effect_that_stands_alone_is_sought(monkeypatch) -> None:
    assert stages(monkeypatch, 0.5 * WELL_EXPLAINED, 0.0) == [(0, NOISE), (1, WELL_EXPLAINED)]


def test_an_effect_that_stands_alone_has_to_do_so_beside_free_numbers(monkeypatch) -> None:
    alone = (1, WELL_EXPLAINED)
    found = stages(monkeypatch, 0.5 * WELL_EXPLAINED, 0.0, finds=alone)
    assert found == [(0, NOISE), alone, (0, NOISE), (6, WELL_EXPLAINED)]


def test_what_few_effects_explain_in_every_channel_needs_no_free_numbers(monkeypatch) -> None:
    assert stages(monkeypatch, 1.5 * WELL_EXPLAINED, 0.5 * LEAST_GAIN) == [(0, NOISE), (6, NOISE)]


def test_where_several_of_the_effects_may_be_numbers_those_are_freed_however_well_it_is_explained(monkeypatch) -> None:
    several = stages(monkeypatch, 1.5 * WELL_EXPLAINED, 0.5 * LEAST_GAIN, effects=SEVERAL)
    assert several == [(0, NOISE), (6, NOISE), (0, NOISE), (6, WELL_EXPLAINED)]


def test_an_effect_that_is_smaller_than_data_sheets_are_exact_has_to_stand_beside_free_numbers(monkeypatch) -> None:
    """Springs half a per cent soft: a robot whose numbers were 1 to 3 % off was told so (seed 20000, number 4)."""
    free = stages(monkeypatch, 1.5 * WELL_EXPLAINED, 0.5 * LEAST_GAIN, inexact=True)
    assert free == [(0, NOISE), (6, NOISE), (0, NOISE), (6, WELL_EXPLAINED)]


@pytest.mark.parametrize(("inexact", "found"), [(False, ("backlash",)), (True, ())])
def test_effects_beside_free_numbers_that_are_no_larger_than_those_are_exact_are_none(
    monkeypatch, inexact: bool, found: tuple[str, ...]
) -> None:
    """One motor 0.6 % weak, of a robot with numbers 10 % off, was called an effect (seed 21000, number 4)."""
    chosen = (Selection(SimpleNamespace(effects=names), (), None, [None]) for names in ((), ("backlash",)))
    both = [replace(one, rankings=[["scored"]] if one.fit.effects else []) for one in chosen]
    left = iter(both)
    stubs = {
        "select": lambda *_, **__: next(left),
        "as_far_as_others": lambda freedom, _: freedom,
        "at_end": lambda *_: (),
    }
    stubs |= {"above_floor": lambda *_: 0.0, "all_inexact": lambda effects, _: inexact and bool(effects)}
    for name, stub in stubs.items():
        monkeypatch.setattr(module, name, stub)
    selection = module._freed((), (), None, lambda _: None)
    assert selection.fit.effects == found and selection.rankings == [["scored"]]  # what was asked is told


def test_a_channel_above_its_floor_is_looked_into_however_little_is_left(monkeypatch) -> None:
    """One constant force is little beside the play in twelve knees, and a delay of one joint beside all the others."""
    assert stages(monkeypatch, 1.5 * WELL_EXPLAINED, 2.0 * LEAST_GAIN)[2:] == [(0, NOISE), (6, NOISE)]


def test_numbers_a_little_off_explain_a_rest_that_is_small_in_every_channel(monkeypatch) -> None:
    assert stages(monkeypatch, 4.0 * WELL_EXPLAINED, 0.0)[2:] == [(0, NOISE), (6, WELL_EXPLAINED)]


def test_without_the_rows_that_noise_decides_the_nominal_numbers_are_tried_again(monkeypatch) -> None:
    log = SimpleNamespace(standing=True, rigid=False, atoms=SimpleNamespace(effects=()))
    again = stages(monkeypatch, 4.0 * WELL_EXPLAINED, 1e6, (log,), 0.5 * ROUGH)
    assert again == [(0, NOISE), (6, NOISE), (6, NOISE)]
    several = stages(monkeypatch, 4.0 * WELL_EXPLAINED, 1e6, (log,), 0.5 * ROUGH, effects=2)
    assert several == [*again, (0, NOISE), (6, NOISE)]  # which may be numbers that are off, and one effect
    further = stages(monkeypatch, 4.0 * WELL_EXPLAINED, 1e6, (log,), 2.0 * ROUGH)
    assert further == [*again, (0, NOISE), (6, NOISE), (0, NOISE), (6, NOISE)]  # and so are numbers a little off


def test_effects_that_explain_a_log_beside_others_as_numbers_are_enough(monkeypatch) -> None:
    strong = 1e3
    enough = stages(monkeypatch, strong, 1e6, kept=0.4 * LITTLE * strong)
    assert enough == [(0, NOISE), (6, NOISE)]
    assert stages(monkeypatch, strong, 1e6, kept=2.0 * LITTLE * strong) == [*enough, (0, NOISE), (6, NOISE)]


def test_ripple_lines_are_sought_in_what_is_left_at_the_fit(monkeypatch) -> None:
    effects = (LIBRARY["torque_ripple"],)
    log = SimpleNamespace(seeds_at=lambda point: {"torque_ripple": ({"harmonic": point},)})
    changes, _ = changes_of(effects, [log], [123.0])
    assert {dict(change.shapes)["harmonic"] for change in changes} == {123.0}


@pytest.mark.parametrize("name", ["spring_stiffening", "torque_constant_saturation"])
def test_a_curved_effect_is_tried_at_several_strengths(name: str) -> None:
    """A cube says little of itself near zero, and so does a strong saturation: what scored was another effect."""
    changes, variants = changes_of((LIBRARY[name],))
    assert len(variants) == 4 and max(c.step for c in changes) >= 10 * min(c.step for c in changes)


def test_an_effect_of_the_users_that_says_it_is_sharp_is_tried_so_too() -> None:
    own = replace(LIBRARY["cubic_friction"], name="own")
    assert [len(changes_of((one,))[1]) for one in (own, replace(own, sharp=True))] == [1, 4]


def test_only_time_tells_whether_a_fine_effect_is_steady() -> None:
    own = replace(LIBRARY["cubic_friction"], name="own")
    assert [len(_states_of(one)) for one in (own, replace(own, fine=True), replace(own, sharp=True))] == [4, 1, 1]


@pytest.mark.parametrize(
    ("verdict", "held_out", "told"), [("explained", 4.46, 1), ("explained", 1.4, 0), ("none", 9, 0)]
)
def test_it_is_told_when_half_of_a_log_does_not_teach_the_other_half(monkeypatch, verdict, held_out, told) -> None:
    """hops with a supply of 2.5 ohm were explained whole, and by half of them to 4.46 noises."""
    monkeypatch.setattr(diagnosis, "held_out_error", lambda logs, proof: held_out)
    selection = Selection(None, (), None, [SimpleNamespace(proof=None)])
    words = diagnosis._less_sure(verdict, selection, ())
    assert len(words) == told and all("4.5 times the noise" in sentence for sentence in words)
