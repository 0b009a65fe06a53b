"""Perturbation files: what is refused, and that every name changes just what it says."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import kstest, truncnorm

from experiments.effects import LIBRARY
from experiments.errors import UserError
from experiments.model import FittedValue, PlacedEffect, nominal_model
from experiments.perturbations import (
    SHIPPED,
    describe,
    load_perturbations,
    parse_perturbations,
    perturbations_of_search,
    perturbations_of_task,
)
from experiments.plant import make_plant
from experiments.sensing import NOISE
from experiments.tasks.definition import load_task
from experiments.trial import BIASES, DISTURBANCES, NOISE_ROWS, PERTURBATIONS, Trial, noise_row, noise_table
from experiments.tune import TuneOptions
from mjx_starleth.terrain import ground_contact


@pytest.fixture(scope="module")
def plant():
    return make_plant(nominal_model())


def trial(**numbers: float) -> Trial:
    values = {name: jnp.float32(value) for name, value in numbers.items()}
    return Trial(values, noise_table(), jnp.int32(7))


@pytest.mark.parametrize("name", SHIPPED)
def test_the_shipped_files_are_read(name: str) -> None:
    assert load_perturbations(name, nominal_model()).names


@pytest.mark.parametrize(
    ("draw", "match"),
    [
        ({"no_such": {"law": "fixed", "value": 1}}, "nothing is called 'no_such'"),
        ({"torso_mass": {"law": "triangle"}}, "torso_mass"),
        ({"torso_mass": {"law": "uniform", "low": 2, "high": 1}}, "low = 2 lies above high = 1"),
        ({"torso_mass": {"law": "normal", "mean": 1, "std": 0.5}}, "-0.5 to 2.5 1, which leaves the possible range"),
        ({"push_x": {"law": "fixed", "value": "NaN"}}, "push_x"),
        ({"backlash@LF_KFE.width": {"law": "fixed", "value": -1}}, "backlash"),
        ({"flubber@all.x": {"law": "fixed", "value": 0}}, "no effect 'flubber'"),
        ({"payload@": {"law": "fixed", "value": 0}}, "has no such parameter"),
        ({"command_delay@nose.delay": {"law": "fixed", "value": 0}}, "no place 'nose'"),
        ({f"n{i}": {"law": "fixed", "value": 0} for i in range(201)}, "200"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused(draw, match) -> None:
    with pytest.raises(UserError, match=match) as caught:
        parse_perturbations({"draw": draw}, "file.json", nominal_model())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_each_number_of_the_plant_is_unchanged_at_nominal_and_changed_elsewhere(plant, name: str) -> None:
    p = PERTURBATIONS[name]

    def applied(value):
        return jax.tree.leaves(trial(**{name: value}).apply(plant, plant.params))

    before = jax.tree.leaves(plant.params)
    assert all(np.array_equal(a, b) for a, b in zip(before, applied(p.nominal), strict=True))
    off = p.nominal + 0.1 * (p.high - p.nominal)
    assert any(not np.array_equal(a, b) for a, b in zip(before, applied(off), strict=True))


FACTORS = {
    "gear_friction": {"friction_coulomb", "friction_viscous", "friction_cubic"},
    "spring_stiffness": {"spring_stiffness"},
    "spring_damping": {"spring_damping"},
    "torque_constant": {"torque_constant", "back_emf_constant"},  # one constant of the motor in two units
    "motor_inertia": {"motor_inertia"},
    "resistance": {"resistance"},
    "battery_voltage": {"bus_voltage"},
}


@pytest.mark.parametrize("name", FACTORS)
def test_a_factor_of_the_drive_scales_its_numbers_and_no_others(plant, name: str) -> None:
    before, after = plant.params.drive, trial(**{name: 1.5}).apply(plant, plant.params).drive
    for field, value in before._asdict().items():
        factor = 1.5 if field in FACTORS[name] else 1.0
        np.testing.assert_allclose(getattr(after, field), factor * value, rtol=1e-6, err_msg=field)


@pytest.mark.parametrize(("name", "chosen"), [("torso_mass", slice(0, 1)), ("link_mass", slice(1, 13))])
def test_a_heavier_part_has_more_mass_and_inertia_and_the_others_do_not(plant, name: str, chosen: slice) -> None:
    before, after = plant.params.bodies, trial(**{name: 1.25}).apply(plant, plant.params).bodies
    factor = np.ones(13)
    factor[chosen] = 1.25
    np.testing.assert_allclose(after.mass, before.mass * factor, rtol=1e-6)
    np.testing.assert_allclose(after.inertia, before.inertia * factor[:, None], rtol=1e-6)


@pytest.mark.parametrize(("name", "axis"), [("torso_com_x", 0), ("torso_com_y", 1)])
def test_the_centre_of_mass_moves_along_its_axis(plant, name: str, axis: int) -> None:
    moved = trial(**{name: 0.03}).apply(plant, plant.params).bodies.com - plant.params.bodies.com
    expected = np.zeros((13, 3))
    expected[0, axis] = 0.03
    np.testing.assert_allclose(moved, expected, atol=1e-7)


def test_a_search_may_be_harder_than_what_judges_its_result() -> None:
    model = nominal_model()
    hard = {"push_y": {"law": "fixed", "value": 77.0}}
    definition = load_task("bound").model_copy(update={"search_perturbations": hard})
    own, search = (f(definition, None, model) for f in (perturbations_of_task, perturbations_of_search))
    options = TuneOptions(definition, model, 0, own, search_law=search)
    (judging, _), (searching, _) = (draw(jax.random.key(3), 50) for draw in (options.trials, options.search_trials))
    assert np.abs(judging["push_y"]).max() < 77.0 and np.all(searching["push_y"] == 77.0)
    assert set(judging) == set(searching)
    for name in set(judging) - {"push_y"}:
        np.testing.assert_array_equal(judging[name], searching[name])
    # what the user asks for counts for both
    assert perturbations_of_search(definition, "rough", model) == load_perturbations("rough", model)
    odd = definition.model_copy(update={"search_perturbations": {"torque_bias": {"law": "fixed", "value": 1.0}}})
    with pytest.raises(UserError, match="correct 'torque_bias'"):
        perturbations_of_search(odd, None, model)


def test_an_effect_that_the_model_lacks_can_be_perturbed() -> None:
    model = nominal_model()
    laws = parse_perturbations(
        {"draw": {"joint_encoder_offset@LF_KFE.offset": {"law": "fixed", "value": 0.01}}}, "test", model
    )
    plant = make_plant(laws.on(model))
    numbers = trial(**{"joint_encoder_offset@LF_KFE.offset": 0.25}).apply(plant, plant.params).effects
    offset = np.asarray(numbers[0]["offset"])
    assert offset[2] == np.float32(0.25) and (np.delete(offset, 2) == 0).all()
    assert laws.on(model).hash() != model.hash() and not model.effects


def test_an_uncertain_effect_of_the_model_keeps_its_own_value_as_nominal() -> None:
    payload = PlacedEffect(effect="payload", where="torso", parameters={"mass": FittedValue(value=2.0)})
    model = nominal_model().with_effect(payload)
    name = next(f"payload@torso.{p.name}" for p in LIBRARY["payload"].strengths if p.name == "mass")
    assert describe(name, model).nominal == 2.0 and describe(name, nominal_model()).nominal == 0.0
    laws = parse_perturbations({"draw": {name: {"law": "normal", "mean": 2.0, "std": 0.1}}}, "test", model)
    assert laws.on(model).hash() == model.hash()


def test_biases_are_constant_and_of_the_size_asked_for() -> None:
    units = {"encoder_bias": NOISE.joint_position, "torque_bias": NOISE.joint_torque, "gyro_bias": NOISE[-1]}
    assert set(units) == set(BIASES) == {n for n in DISTURBANCES if n.endswith("_bias")}

    @jax.jit
    @jax.vmap
    def rows(start):
        one = Trial({name: jnp.float32(0.1) for name in units}, noise_table(), start)
        return noise_row(one, 3), noise_row(one, 1000)

    drawn, later = (np.asarray(x) for x in rows(jnp.arange(1, 400)))
    np.testing.assert_array_equal(drawn, later)
    for name, unit in units.items():
        # 399 times 3 or 12 normal numbers: their spread is known to 5 % or better
        assert drawn[:, BIASES[name][0]].std() * unit == pytest.approx(0.1, rel=0.08)
    assert drawn.any(0).sum() == 12 + 12 + 3


def test_a_bias_is_not_the_noise_of_a_tick() -> None:
    bias = np.asarray(noise_row(trial(encoder_bias=NOISE.joint_position), jnp.int32(0)))[:12]
    noise = np.asarray(jax.vmap(lambda k: noise_row(trial(sensor_noise=1.0), k))(jnp.arange(50)))[:, :12]
    assert np.abs(noise - bias).max(1).min() > 0.1


def test_the_sensor_noise_of_two_trials_is_not_the_same_noise() -> None:
    @jax.jit
    def window(start):
        one = trial(sensor_noise=1.0)._replace(noise_start=start)
        return jax.vmap(lambda k: noise_row(one, k))(jnp.arange(2000))

    first = np.asarray(window(0))
    assert abs(first.mean()) < 0.02 and first.std() == pytest.approx(1.0, abs=0.02)
    # a whole table later one half of each row comes again, the other half does not; any other start shares no row
    for start, shared in ((4096, 0.5), (4093, 0.5), (3 * 4096 + 17, 0.0), (NOISE_ROWS - 1, 0.0)):
        found = np.corrcoef(first.ravel(), np.asarray(window(start)).ravel())[0, 1]
        assert found == pytest.approx(shared, abs=0.02)
    late = NOISE_ROWS - 5  # the stream begins anew behind its last row
    np.testing.assert_array_equal(np.asarray(window(late))[5:], first[:-5])


def test_a_normal_law_is_cut_and_not_heaped_up_at_its_ends() -> None:
    law = {"draw": {"torso_mass": {"law": "normal", "mean": 1.0, "std": 0.05}}}
    laws = parse_perturbations(law, "test", nominal_model())
    drawn = (laws.columns(jax.random.key(5), 20_000)[0]["torso_mass"] - 1.0) / 0.05
    assert np.abs(drawn).max() <= 3.0 + 1e-5 and np.abs(drawn).max() > 2.9
    assert kstest(drawn, truncnorm(-3, 3).cdf).pvalue > 0.01
    assert len(np.unique(drawn)) > 19_000


def test_a_board_lies_where_it_was_put(plant) -> None:
    numbers = {"obstacle_height": 0.03, "obstacle_x": 0.3, "obstacle_y": -0.2, "obstacle_width": 0.4}
    bodies = trial(**numbers).apply(plant, plant.params).bodies
    feet = jnp.asarray([[0.3, -0.2, 0.06], [0.3, -0.35, 0.06], [0.3, 0.1, 0.06], [0.45, -0.2, 0.06]], jnp.float32)
    gap = jax.jit(ground_contact)(bodies.terrain, feet, bodies.foot_radius, bodies.friction).gap
    np.testing.assert_allclose(np.asarray(gap), 0.06 - 0.02 - np.array([0.03, 0.03, 0, 0]), atol=1e-6)
