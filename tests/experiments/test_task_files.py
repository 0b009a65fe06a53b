"""Task files: what makes no sense is one sentence before a folder is made, generations are shared out over stages."""

import pytest

from experiments.errors import UserError
from experiments.model import nominal_model
from experiments.tasks.definition import load_task, parse_task, task_names
from experiments.tasks.registry import make_task


@pytest.mark.parametrize(
    ("task", "change", "match"),
    [
        ("squat_jump", {"duration": 0.5}, "too short for a jump"),
        ("squat_jump", {"settings": {"colour": 1}}, "no settings; remove the key 'colour'"),
        ("squat_jump", {"parameters": load_task("squat_jump").parameters[:1]}, "its parameters are height_0"),
        ("squat_jump", {"weights": load_task("squat_jump").weights | {"apex": 1e308}}, "weights.apex"),
        ("running_trot", {"duration": 2.0}, "judged from 2.2 s on"),
        ("running_trot", {"weights": {}}, "correct the key"),
    ],
)
def test_a_task_that_makes_no_sense_is_one_sentence(task: str, change: dict, match: str) -> None:
    content = load_task(task).model_dump(mode="json") | change
    with pytest.raises(UserError, match=match) as error:
        make_task(parse_task(content, "task.json"), nominal_model())
    assert "\n" not in str(error.value)


USUAL = {"slope": [0.1, 0.2], "excess": [0.3, 0.5], "rise": 0.1, "calm": 2.0}


@pytest.mark.parametrize(
    ("caution", "match"),
    [
        ([], "an object of caution and controller"),
        (USUAL | {"slope": [0.2, 0.1]}, "slope, excess and tilt must be two growing numbers"),
        (USUAL | {"excess": [0.5, 0.5]}, "slope, excess and tilt must be two growing numbers"),
        (USUAL | {"tilt": [0.2, 0.1]}, "slope, excess and tilt must be two growing numbers"),
        (USUAL | {"rise": 0.0}, "rise and calm must be more than zero"),
        (USUAL | {"colour": 1.0}, "does not know 'colour'"),
    ],
)
def test_a_careful_form_that_makes_no_sense_is_one_sentence(caution, match: str) -> None:
    content = load_task("running_trot").model_dump(mode="json")
    content["settings"]["careful"]["caution"] = caution
    with pytest.raises(UserError, match=match) as error:
        make_task(parse_task(content, "task.json"), nominal_model())
    assert "\n" not in str(error.value)


def test_what_a_careful_form_does_not_name_never_asks_for_it() -> None:
    content = load_task("running_trot").model_dump(mode="json")
    content["settings"]["careful"]["caution"] = {"rise": 0.1, "calm": 2.0}
    caution = make_task(parse_task(content, "task.json"), nominal_model()).settings.caution
    assert min(*caution.slope, *caution.excess, *caution.tilt) > 100.0


def test_a_bound_that_float32_does_not_hold_is_refused() -> None:
    content = load_task("squat_jump").model_dump(mode="json")
    content["parameters"][0]["high"] = 1e300
    with pytest.raises(UserError, match="'height_0': high = 1e\\+300 is too large"):
        parse_task(content, "task.json")


@pytest.mark.parametrize("task", task_names())
@pytest.mark.parametrize("total", [4, 5, 7, 100, 251])
def test_generations_are_shared_out_and_every_stage_has_one(task: str, total: int) -> None:
    counts = [stage.generations for stage in load_task(task).with_generations(total).stages]
    assert sum(counts) == total and min(counts) >= 1


def test_a_generation_that_fits_into_no_memory_is_refused() -> None:
    definition = load_task("squat_jump").with_population(10_000).with_trials(1000)
    for more in (lambda: definition.with_trials(1001), lambda: definition.with_population(10_001)):
        with pytest.raises(UserError, match="more than the 10000000 rollouts of one generation"):
            more()


def test_fewer_generations_than_stages_are_refused() -> None:
    with pytest.raises(UserError, match="too few"):
        load_task("running_trot").with_generations(2)


def test_a_search_goes_on_from_a_found_motion_in_its_last_stage() -> None:
    definition = load_task("squat_jump")
    values = definition.space().named(0.5 * (definition.space().low + definition.space().high))
    further = definition.going_on_from(values)
    assert further.space().named(further.space().initial) == pytest.approx(values)
    assert further.stages == definition.stages[-1:] and further.sigma < definition.sigma
    assert further.hash() == definition.hash(), "the result belongs to the same task"


@pytest.mark.parametrize("change", [{"foot_0": 9.0}, {"colour": 1.0}])
def test_a_search_does_not_start_from_a_motion_of_another_task(change: dict) -> None:
    definition = load_task("squat_jump")
    with pytest.raises(UserError, match=r"The search cannot start there: .*; start from a motion of this task"):
        definition.going_on_from(definition.space().named(definition.space().initial) | change)
