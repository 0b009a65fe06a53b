"""The numbers file: what it gives back and what it refuses."""

import copy
import json
from importlib import resources

import pytest

from mjx_starleth.numbers import load_numbers, robot_numbers

RAW = json.loads((resources.files("mjx_starleth") / "starleth.json").read_text())


def changed(path: str, value) -> dict:
    data = copy.deepcopy(RAW)
    *parents, last = path.split(".")
    place = data
    for key in parents:
        place = place[key]
    place[last] = value
    return data


def paths(data: dict, above: str = "") -> list[str]:
    """Of every value of the file."""
    found = []
    for key, value in data.items():
        found += paths(value, f"{above}{key}.") if isinstance(value, dict) else [f"{above}{key}"]
    return found


def test_every_value_has_a_source_and_every_source_a_value():
    values = paths({key: value for key, value in RAW.items() if key not in ("about", "sources")})
    places = [name for name in RAW["sources"] if not name.isupper()]

    def covers(place, value):
        return value == place or value.startswith(f"{place}.")

    for value in values:
        assert sum(covers(place, value) for place in places) == 1, value
    for place in places:
        assert any(covers(place, value) for value in values), place


def test_the_dump_is_the_file():
    assert json.loads(json.dumps(load_numbers().model_dump())) == RAW


@pytest.mark.parametrize(
    ("path", "value", "part"),
    [
        ("gravity", -9.81, "gravity"),
        ("gravity", float("nan"), "gravity"),
        ("gravity", "9.81", "gravity"),
        ("bodies.hip.mass", 0.0, "bodies.hip.mass"),
        ("bodies.torso.inertia_diagonal", [1.0, 0.1, 0.1], "largest moment"),
        ("joint_limits_LF.HAA", [0.5, -0.4], "lower bound"),
        ("legs", ["RF", "LF", "LH", "RH"], "legs"),
        ("loops.velocity_period", 0.6e-3, "whole number"),
        ("loops.current_period", 1e-320, "at most 1000"),
        ("loops.current_period", 1e-9, "at most 1000"),
        ("contact.restitution", 1.5, "restitution"),
        ("unheard_of", 1.0, "unheard_of"),
    ],
)
def test_a_wrong_value_is_named_in_one_sentence(path, value, part):
    with pytest.raises(ValueError) as caught:
        robot_numbers(changed(path, value))
    text = str(caught.value)
    assert part in text and "\n" not in text and text.endswith(".")


def test_a_file_that_is_no_robot_is_refused(tmp_path):
    for content in (b"{", b"[]", b"\xff\xfe", b"[" * 100_000, b" " * 1_000_001):
        file = tmp_path / "robot.json"
        file.write_bytes(content)
        with pytest.raises(ValueError, match="Robot file") as caught:
            load_numbers(file)
        assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="cannot be read"):
        load_numbers(tmp_path / "absent.json")
