"""The parameter file: what is written is read, and nothing else is."""

import hashlib
import json
import random
from importlib import resources
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments import parameter_file
from experiments.errors import UserError
from experiments.parameter_file import checksum, gate, parameter, read_parameters, write_parameters
from experiments.parameter_schema import SCHEMA_ID, ParameterFile, json_schema
from experiments.tasks.definition import load_task, task_of

SCHEMA = Path(parameter_file.__file__).parent / "schemas" / "parameters.schema.json"
FULL_FUZZ = 100_000  # inputs of the slow test
QUICK_FUZZ = 4000


def fields() -> dict:
    """Everything a file may hold."""
    spread = {"mean": 0.7, "std": 0.01, "low": 0.66, "high": 0.73}
    return {
        "task": "squat_jump",
        "task_hash": "fedcba9876543210",
        "robot": "starleth",
        "model_hash": "0123456789abcdef",
        "parameters": [
            {"name": "height_knot_1", "value": 0.31, "unit": "m", "low": 0.22, "high": 0.55},
            {"name": "vertical_damping", "value": 120, "unit": "N s/m", "low": 0.0, "high": 400.0},
        ],
        "metrics": {
            "apex_height": {"value": 0.72, "unit": "m", "spread": spread},
            "landed": {"value": True, "unit": "-", "spread": {"mean": 0.98, "std": 0.1, "low": 0, "high": 1}},
        },
        "cost_terms": {"apex": -7.2, "slip": 0.01},
        "perturbed": {"trials": 64, "seed": 3, "perturbations": {"link_mass": "normal, 5 %"}},
        "robustness_gate": {
            "required": 0.95,
            "passed": True,
            "success_rate": 0.98,
            "ci95": [0.96, 0.99],
            "trials": 256,
            "seed": 3,
            "perturbations": {"link_mass": "normal, 5 %"},
        },
        "drive": "full",
        "seed": 7,
        "search": {"generations": 250, "population": 15, "stages": "ideal, limits, full", "sigma": 0.25},
        "versions": {"starleth": "0.1.0", "jax": "0.10.2"},
        "created": parameter_file.now(),
        "command": "starleth replay parameters.json",
    }


@pytest.fixture
def path(tmp_path) -> Path:
    write_parameters(tmp_path / "parameters.json", **fields())
    return tmp_path / "parameters.json"


def rewrite(path: Path, **changes) -> None:
    """Change keys and sign the file again, as a careful forger would."""
    content = json.loads(path.read_text()) | changes
    path.write_text(json.dumps(content | {"checksum": checksum(content)}))


def refused(path: Path, match: str, **expected) -> None:
    with pytest.raises(UserError, match=match) as caught:
        read_parameters(path, **expected)
    text = str(caught.value)
    assert "\n" not in text and text.endswith(".") and len(text) < 700


def tuned_for(definition, path: Path):
    """A parameter file of a task's initial guess."""
    parameters = [parameter(p.name, p.initial, p.unit, p.low, p.high) for p in definition.parameters]
    own = {"task_hash": definition.hash(), "parameters": parameters}
    return write_parameters(path, **fields() | own)


def test_a_motion_is_replayed_on_the_task_that_it_was_tuned_for(tmp_path):
    shipped = load_task("squat_jump")
    longer = shipped.model_copy(update={"duration": 3.0})
    own, path = tmp_path / "own.json", tmp_path / "parameters.json"
    own.write_text(longer.model_dump_json())

    assert task_of(tuned_for(shipped, path), path) == shipped
    searched_otherwise = shipped.with_generations(7).model_copy(update={"population": 40})
    assert task_of(tuned_for(searched_otherwise, path), path) == shipped

    file = tuned_for(longer, path)
    assert task_of(file, path, str(own)) == longer
    with pytest.raises(UserError, match=r"another duration, weights or settings; give the task file .* by --task FILE"):
        task_of(file, path)
    with pytest.raises(UserError, match="parameters of another task than 'pronk'"):
        task_of(file, path, "pronk")


def test_files_from_before_the_task_was_recorded_are_read():
    for example in resources.files("experiments.examples").iterdir():
        if example.name.endswith(".json"):
            file = read_parameters(str(example), allow_ungated=True)
            assert task_of(file, Path(example.name)).task == file.task


def test_round_trip(path):
    written = write_parameters(path, **fields())
    read = read_parameters(path, robot="starleth", model_hash="0123456789abcdef", task="squat_jump")
    assert read == written
    assert read.values() == {"height_knot_1": 0.31, "vertical_damping": 120}
    assert read.metrics["landed"].value is True and read.metrics["apex_height"].spread.mean == 0.7


def test_optional_parts_may_be_missing(path):
    optional = fields() | {"perturbed": None, "robustness_gate": None}
    optional["metrics"]["apex_height"]["spread"] = None
    write_parameters(path, **optional)
    assert read_parameters(path, allow_ungated=True).robustness_gate is None


def test_the_published_schema_is_the_model(path):
    published = json.loads(SCHEMA.read_text())
    assert published == json_schema(ParameterFile, SCHEMA_ID)
    jsonschema.Draft202012Validator.check_schema(published)
    validator = jsonschema.Draft202012Validator(published)
    content = json.loads(path.read_text())
    assert list(validator.iter_errors(content)) == []
    for broken in (
        {k: v for k, v in content.items() if k != "seed"},
        content | {"extra": 1},
        content | {"schema_version": 1},
        content | {"parameters": [content["parameters"][0] | {"value": "0.3"}]},
        content | {"model_hash": "xyz"},
    ):
        assert list(validator.iter_errors(broken))


def test_the_checksum_is_the_documented_one(path):
    """SHA-256 of sorted, spaceless JSON; Python spells these numbers as RFC 8785 does, but for 120.0."""
    content = json.loads(path.read_text())
    stated = content.pop("checksum")
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    for whole in ("120.0", "400.0", "0.0", "1.0"):
        text = text.replace(f":{whole},", f":{whole[:-2]},").replace(f":{whole}}}", f":{whole[:-2]}}}")
    assert hashlib.sha256(text.encode()).hexdigest() == stated


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"schema_version": 1}, "schema version 1"),
        ({"schema_version": True}, "schema version True"),
        ({"schema_version": 2.0}, "schema version 2.0"),
        ({"parameters": []}, "parameters"),
        ({"parameters": [fields()["parameters"][0]] * 2}, "twice"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**60}, "not representable|seed|exceeds"),
        ({"model_hash": "0123456789ABCDEF"}, "model_hash"),
        ({"command": None}, "command"),
        ({"task": "../../etc"}, "task"),
        ({"task": "a/../b"}, "task"),
        ({"unknown": 1}, "unknown"),
        ({"created": "yesterday"}, "created"),
    ],
)
def test_a_signed_file_of_the_wrong_form_is_refused(path, changes, match):
    try:
        rewrite(path, **changes)
    except ValueError:  # beyond RFC 8785: leave the old checksum
        path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    refused(path, match)


def test_a_signed_value_out_of_bounds_is_refused(path):
    first, second = fields()["parameters"]
    rewrite(path, parameters=[first, second | {"value": 400.0001}])
    refused(path, r"vertical_damping = 400 N s/m lies outside \[0, 400\]|lies outside")


def test_other_robot_model_or_task(path):
    refused(path, "for the robot 'starleth', not for 'joint'", robot="joint")
    refused(path, "tuned on the model 0123456789abcdef, not on", model_hash="f" * 16)
    refused(path, "for the task 'squat_jump', not for 'pronk'", task="pronk")


def test_a_failed_gate_is_refused_unless_allowed(path):
    failed = fields()["robustness_gate"] | {"passed": False, "success_rate": 0.97, "ci95": [0.94, 0.98]}
    write_parameters(path, **fields() | {"robustness_gate": failed})
    refused(path, "failed its robustness gate .97.0% of 256 trials succeeded, so at least 94.0% .*95.0% required")
    assert read_parameters(path, allow_ungated=True).robustness_gate.passed is False


def test_a_file_without_a_gate_is_refused_unless_allowed(path):
    write_parameters(path, **fields() | {"robustness_gate": None})
    refused(path, "has not been through a robustness gate; run 'starleth robustness")
    assert read_parameters(path, allow_ungated=True).robustness_gate is None


def test_the_gate_asks_for_confidence_not_for_luck():
    """All of 58 successes leave 95 % sure of no more than 93.8 %; all of 72 are the first to show 95 %."""
    assert not gate(0.95, 58, 58, 0, {}).passed
    assert not gate(0.95, 71, 71, 0, {}).passed and gate(0.95, 72, 72, 0, {}).passed


def test_a_gate_cannot_pass_with_too_low_a_rate(path):
    rewrite(path, robustness_gate=fields()["robustness_gate"] | {"success_rate": 0.97, "ci95": [0.94, 0.98]})
    refused(path, "passed contradicts")


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_what_is_not_finite_is_neither_written_nor_read(tmp_path, path, bad):
    broken = fields()
    broken["metrics"]["apex_height"]["value"] = bad
    with pytest.raises(UserError, match=r"was not written: 'metrics\.apex_height"):
        write_parameters(tmp_path / "new.json", **broken)
    assert not (tmp_path / "new.json").exists()
    content = json.loads(path.read_text())
    content["parameters"][0]["value"] = bad
    path.write_text(json.dumps(content))
    refused(path, "NaN|Infinity")


def test_a_failed_write_keeps_the_old_file(path):
    old = path.read_bytes()
    with pytest.raises(UserError, match="outside"):
        write_parameters(path, **fields() | {"parameters": [fields()["parameters"][0] | {"value": 9.0}]})
    assert path.read_bytes() == old


@pytest.mark.parametrize("text", ["", "{}", "[]", "null", "1", '"x"', '{"schema_version": 1}'])
def test_other_json_is_no_parameter_file(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    refused(tmp_path / "a.json", "a.json is not")


@given(
    st.floats(-1e3, 1e3, allow_subnormal=False),
    st.floats(1e-3, 1e3),
    st.floats(0, 1),
)
@settings(deadline=None)
def test_float32_rounding_at_a_bound_is_forgiven_and_no_more(low, width, where):
    high = low + width
    value = float(np.float32(low + where * width))
    built = parameter("p", value, "m", low, high)
    assert low <= built.value <= high
    assert np.float32(built.value) == np.float32(value)  # the replayed motion is the searched one to the bit
    outside = float(np.nextafter(np.nextafter(np.float32(high), np.float32(np.inf)), np.float32(np.inf)))
    with pytest.raises(ValueError, match="outside"):
        parameter("p", outside, "m", low, high)


VALUES = st.floats(allow_nan=False, allow_infinity=False)


@given(
    st.dictionaries(
        st.from_regex(r"\A[A-Za-z][A-Za-z0-9_.@/:\-]{0,20}\Z"), st.tuples(VALUES, VALUES, VALUES), min_size=1
    )
)
@settings(max_examples=150, deadline=None)
def test_any_parameters_survive_to_the_bit(tmp_path_factory, numbers):
    path = tmp_path_factory.mktemp("any") / "p.json"
    rows = []
    for name, triple in numbers.items():
        low, value, high = sorted(triple)
        rows.append({"name": name, "value": value, "unit": "m", "low": low, "high": high})
    write_parameters(path, **fields() | {"parameters": rows})
    read = read_parameters(path)
    assert [(p.name, p.low, p.value, p.high) for p in read.parameters] == [
        (r["name"], r["low"], r["value"], r["high"]) for r in rows
    ]


def damaged(whole: bytes, rng: random.Random) -> bytes:
    """One of the ways in which files go wrong."""
    at, other = rng.randrange(len(whole)), rng.randrange(len(whole))
    kind = rng.randrange(6)
    if kind == 0:  # one bit
        return whole[:at] + bytes([whole[at] ^ 1 << rng.randrange(8)]) + whole[at + 1 :]
    if kind == 1:  # one byte
        return whole[:at] + bytes([rng.randrange(256)]) + whole[at + 1 :]
    if kind == 2:  # torn
        return whole[:at]
    if kind == 3:  # a piece lost or doubled
        return whole[:at] + whole[other:]
    if kind == 4:  # a hole, as after a power cut
        return whole[:at] + bytes(min(512, len(whole) - at)) + whole[at + 512 :]
    digits = [i for i, byte in enumerate(whole) if chr(byte).isdigit()]  # a digit for a digit: still valid JSON
    at = rng.choice(digits)
    return whole[:at] + bytes([rng.randrange(48, 58)]) + whole[at + 1 :]


def fuzz(path: Path, count: int, seed: int) -> int:
    """Read `count` damaged files; returns how many were accepted, all proven unchanged in content."""
    rng = random.Random(seed)
    whole = path.read_bytes()
    original = ParameterFile.model_validate(json.loads(whole))
    target = path.with_name("damaged.json")
    accepted = 0
    for _ in range(count):
        data = damaged(whole, rng)
        target.write_bytes(data)
        try:
            read = read_parameters(target)
        except UserError as error:
            assert "\n" not in str(error) and len(str(error)) < 700
            continue
        accepted += 1
        assert read == original
    return accepted


def test_damage_is_refused_or_harmless(path):
    accepted = fuzz(path, QUICK_FUZZ, seed=1)
    assert accepted < QUICK_FUZZ / 5  # white space, unchanged digits


@pytest.mark.slow
def test_much_damage_is_refused_or_harmless(path):
    fuzz(path, FULL_FUZZ, seed=2)


def test_every_byte_flipped_and_every_length_torn(path):
    whole = path.read_bytes()
    original = read_parameters(path)
    for at in range(len(whole)):
        for data in (whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :], whole[:at]):
            path.write_bytes(data)
            try:
                assert read_parameters(path) == original
            except UserError:
                pass
