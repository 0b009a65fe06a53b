"""What the benchmark of the diagnosis counts, on cases and answers by hand."""

from typing import Any

import pytest

from experiments.diagnosis_benchmark.score import confusions, table

FRICTION = ("coulomb_friction", "HFE")


def case(*hidden: tuple[str, str], group: str = "single", strength: float = 0.06, richness: str = "rich") -> dict:
    effects = [
        {
            "effect": effect,
            "where": where,
            "strength": strength,
            "in_library": group != "outsider",
            "parameters": {"level": {"value": 0.004}},
        }
        for effect, where in hidden
    ]
    return {"group": group, "motion": "air", "richness": richness, "effects": effects}


def answer(verdict: str, *told: tuple[str, str], low: float = 0.0039) -> dict:
    parameters = {"torque": {"ci95": [low, 0.0042]}}
    effects = [{"effect": effect, "where": where, "parameters": parameters} for effect, where in told]
    return {"verdict": verdict, "effects": effects}


RIGHT = answer("explained", FRICTION)
CASES: dict[str, tuple[dict, dict]] = {
    "right": (case(FRICTION), RIGHT),
    "elsewhere": (case(("coulomb_friction", "LH")), RIGHT),
    "another": (case(("viscous_friction", "HFE")), RIGHT),
    "missed": (case(FRICTION), answer("unknown")),
    "weak": (case(FRICTION, strength=0.04), RIGHT),
    "poor": (case(FRICTION, richness="poor", group="poor"), RIGHT),
    "sound": (case(group="none"), answer("none")),
    "alarm": (case(group="none"), RIGHT),
    "both": (case(FRICTION, ("payload", "torso"), group="pair"), answer("explained", ("payload", "torso"), FRICTION)),
    "one of two": (case(FRICTION, ("payload", "torso"), group="pair"), RIGHT),
    "stranger": (case(("wind", "torso"), group="outsider"), answer("unknown")),
    "trusted": (case(("wind", "torso"), group="outsider"), RIGHT),
}


def counted(names: tuple[str, ...] = tuple(CASES), method: str = "diagnosis") -> dict[str, Any]:
    truth = {name: CASES[name][0] for name in names}
    return table(truth, {name: {method: CASES[name][1]} for name in names}, method)


def test_every_case_counts_where_it_belongs() -> None:
    """Hits of cases: too weak an effect or too poor a motion is nobody's fault."""
    expected = {
        "right_effect_first": [2, 4],
        "right_place": [1, 2],
        "false_alarms": [1, 2],
        "both_of_two": [1, 2],
        "outsiders_unknown": [1, 2],
        "outsiders_confident": [1, 2],
        "intervals_hold": [2, 2],
        "removed_unknown": [0, 0],
    }
    found = counted()
    assert {name: found[name] for name in expected} == expected


def test_without_the_true_effect_in_the_library_an_answer_should_be_unknown() -> None:
    found = counted(("right", "missed"), "removed")
    assert (found["removed_unknown"], found["removed_confident"]) == ([1, 2], [1, 2])


@pytest.mark.parametrize(("low", "held"), [(0.0039, [1, 1]), (0.0041, [0, 1])])
def test_an_interval_holds_the_truth_or_not(low: float, held: list[int]) -> None:
    found = table({"x": case(FRICTION)}, {"x": {"diagnosis": answer("explained", FRICTION, low=low)}}, "diagnosis")
    assert found["intervals_hold"] == held


def test_what_went_wrong_is_told_case_by_case() -> None:
    names = ("right", "missed", "sound", "alarm")
    told = confusions({n: CASES[n][0] for n in names}, {n: {"diagnosis": CASES[n][1]} for n in names})
    assert told == [
        "missed air: coulomb_friction@HFE (0.06) -> unknown: none",
        "alarm air: none -> explained: coulomb_friction@HFE",
    ]


@pytest.mark.parametrize(("low", "held"), [(-0.77, [1, 1]), (-0.62, [0, 1])])
def test_slippery_ground_is_counted_in_the_librarys_unit(low, held) -> None:
    """The plant takes 0.6 off the coefficient of 0.8; the library calls that -75 %."""
    hidden, told = case(("ground_friction", "feet")), answer("explained", ("ground_friction", "feet"))
    hidden["effects"][0]["parameters"] = {"change": {"value": -0.6}}
    told["effects"][0]["parameters"] = {"relative": {"ci95": [low, low + 0.04]}}
    assert table({"one": hidden}, {"one": {"diagnosis": told}}, "diagnosis")["intervals_hold"] == held
