"""Which of several finalists is named, and which count as its rivals."""

from experiments.effects import LIBRARY
from experiments.measurement.linear_score import Scored
from experiments.measurement.selection import Finalist, simplest
from mjx_starleth.names import JOINT_NAMES

NOISE, BEFORE = 1000.0, 9000.0  # chi^2 of noise alone, and without any effect


def finalist(name: str, where: str, held_out: float) -> Finalist:
    return Finalist(Scored(LIBRARY[name], where, 0.0, {}, None), None, held_out)


def named(*finalists: Finalist) -> tuple[str, list[str]]:
    winner, rivals = simplest(sorted(finalists, key=lambda f: f.held_out), BEFORE, NOISE, JOINT_NAMES)
    return winner.scored.where, [f.scored.where for f in rivals]


def test_joints_that_do_not_feel_an_effect_are_not_named_with_it() -> None:
    assert named(finalist("backlash", "LH", 1050.0), finalist("backlash", "LH_HFE", 1051.0)) == ("LH_HFE", [])


def test_joints_that_feel_it_are() -> None:
    assert named(finalist("backlash", "LH", 1050.0), finalist("backlash", "LH_HFE", 1300.0)) == ("LH", [])


def test_another_effect_that_fits_as_well_is_a_rival_unless_it_has_more_parameters() -> None:
    one, other = finalist("coulomb_friction", "HFE", 1050.0), finalist("load_friction", "all", 1060.0)
    assert named(one, other) == ("HFE", ["all"])
    assert named(one, finalist("stribeck_friction", "all", 1045.0)) == ("HFE", [])
