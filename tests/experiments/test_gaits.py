"""Gaits as tasks: their files, how they start, what strides show, and the found parameters."""

import json
from functools import partial
from importlib import resources
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from controller_jax.locomotion import GaitParams
from experiments.batch import device_mesh
from experiments.effects import LIBRARY
from experiments.errors import UserError
from experiments.evaluation import Evaluation, crossed
from experiments.model import nominal_model
from experiments.parameter_file import read_parameters
from experiments.perturbations import parse_perturbations
from experiments.plant import make_plant
from experiments.replay import Motion, load_motion, replay
from experiments.reports.gait_figures import over_strides, stretches
from experiments.tasks.definition import TaskDefinition, load_task
from experiments.tasks.gait_parameters import PARAMETERS, controller_from_settings, robot_numbers, with_values
from experiments.tasks.registry import GAITS, make_task, metric_units
from experiments.trial import Trial, noise_table
from mjx_starleth.mjcf import mjcf
from mjx_starleth.names import LEGS
from sea_jax import JointCommand, JointMeasurement, params_from_numbers
from sea_jax.joint_controllers import wanted_velocity

MODEL = nominal_model()
ROBOT = MODEL.numbers.model_dump(mode="json")
FOUND = resources.files("experiments") / "examples"
CONTACT = 10.0  # N
SEEDS, CYCLES = 100, 20
UNSEEN = 20_000  # seed of trials that no search has seen: searches use the task's seed and the stream of its judge
LEAST_FLIGHT = {"running_trot": 0.1}  # s, each of two a stride; the paper's has about 0.12


@pytest.mark.parametrize("name", GAITS)
def test_task_searches_18_parameters_from_perfect_torque_to_the_full_model(name: str) -> None:
    definition = load_task(name)
    task = make_task(definition, MODEL)
    assert len(definition.parameters) == 18
    first, last = definition.stages[0], definition.stages[-1]
    assert (first.drive, first.sensing, first.perturbed) == ("ideal", "direct", False)
    assert (last.drive, last.sensing, last.perturbed) == ("full", "estimated", True)
    draw = parse_perturbations(definition.perturbations, name, MODEL).names
    assert {"push_x", "push_y", "slope_x", "obstacle_height", "sensor_noise"} <= set(draw)
    assert task.settled < definition.duration - 2 * definition.space().named(definition.space().high)["cycle_duration"]


def test_values_go_where_their_names_say() -> None:
    settings = load_task("bound").settings["controller"]
    controller = controller_from_settings(settings, ROBOT, "bound")
    names = ("duty_factor", "hind_heading_offset", "pitch_damping")
    changed = with_values(controller, names, jnp.array([0.6, 0.01, 7.0]))
    assert float(changed.gait.fore_duty) == float(changed.gait.hind_duty) == np.float32(0.6)
    np.testing.assert_array_equal(changed.foothold.heading_offset, np.float32([0.0, 0.01]))
    np.testing.assert_array_equal(changed.gains.torque_d, np.float32([6.0, 7.0, 100.0]))
    leaves = sum(a is not b for a, b in zip(jax.tree.leaves(changed), jax.tree.leaves(controller), strict=True))
    assert leaves == 4, "nothing else may change"


def test_every_name_has_a_place() -> None:
    controller = controller_from_settings(load_task("pronk").settings["controller"], ROBOT, "pronk")
    for name in PARAMETERS:
        assert isinstance(with_values(controller, (name,), jnp.array([0.5])), GaitParams)


def test_every_shared_number_says_where_it_comes_from() -> None:
    content = json.loads((resources.files("experiments") / "gait_controller.json").read_text())
    content.pop("about")
    sources = {name: text for name, text in content.pop("sources").items() if not name.isupper()}

    def leaves(node, path: str):
        children = node.items() if isinstance(node, dict) else ()
        return [leaf for key, child in children for leaf in leaves(child, f"{path}{key}.")] or [path]

    numbers = leaves(content, "")
    for number in numbers:
        assert sum(number.startswith(f"{place}.") for place in sources) == 1, number
    for place in sources:
        assert any(number.startswith(f"{place}.") for number in numbers), place


def test_what_follows_from_the_robot_is_the_robots() -> None:
    found = robot_numbers(ROBOT)
    model = mujoco.MjModel.from_xml_string(mjcf(MODEL.numbers))
    hips = [model.body(f"{leg}_HIP").pos[0] for leg in LEGS]
    assert float(found["gains.mass"]) == pytest.approx(model.body_mass.sum(), rel=1e-6)
    assert float(found["torso.girdle_distance"]) == pytest.approx(hips[0] - hips[2], rel=1e-6)
    # a stiff joint whose drive follows a ramp of 1 rad/s, led by `position_lead`, is where the ramp is
    drive, lead, dt, steps = params_from_numbers(ROBOT), np.tile(found["swing.position_lead"], 4), 1e-3, 1000
    angle, rate = np.zeros(12, np.float32), np.zeros(12, np.float32)
    for k in range(steps):
        command = JointCommand(np.zeros(12, np.float32), np.float32(k * dt + lead), np.ones(12, np.float32))
        rate = np.asarray(wanted_velocity(drive, command, JointMeasurement(angle, rate, 0 * angle, angle)))
        angle = angle + np.float32(dt) * rate
    np.testing.assert_allclose(angle, steps * dt, atol=2e-3)


@pytest.mark.parametrize(
    "slope, share", [((0.0, 0.0), (1.0, 1.0)), ((0.3, -0.2), (1.0, 1.0)), ((0.0, 0.3), (0.6, 1.0))]
)
def test_a_gait_starts_with_its_feet_on_the_ground_below_the_hips(slope, share) -> None:
    plant, task = make_plant(MODEL, "ideal"), make_task(load_task("walking_trot"), MODEL)
    torso = task.settings.controller.torso._replace(slope_share=jnp.float32(share))
    settings = task.settings._replace(controller=task.settings.controller._replace(torso=torso))
    trial = Trial({"slope_x": jnp.float32(slope[0]), "slope_y": jnp.float32(slope[1])}, noise_table(), jnp.int32(0))
    params = trial.apply(plant, plant.params)
    state, _ = jax.jit(partial(task.start, plant))(params, settings, jnp.zeros(18), trial)
    q, normal = np.asarray(state.bodies.q, float), np.asarray(params.bodies.terrain.normal, float)
    model = mujoco.MjModel.from_xml_string(mjcf(MODEL.numbers))
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    feet = np.stack([data.site(f"{leg}_foot").xpos for leg in LEGS])
    R_WB = Rotation.from_quat(q[[4, 5, 6, 3]]).as_matrix()
    hips = q[:3] + np.asarray(settings.geometry.r_BH_B) @ R_WB.T
    np.testing.assert_allclose(feet @ normal, MODEL.numbers.bodies.foot.radius, atol=1e-5)
    np.testing.assert_allclose((feet - hips)[:, :2], 0.0, atol=2e-3)  # the stance's own feet are 1 mm off
    np.testing.assert_allclose(normal[:2] / normal[2], np.negative(slope), atol=1e-5)
    tilt = share[0] * np.arctan(slope[1]) if slope[0] == 0 else np.arccos(normal[2])
    assert np.arccos(min(R_WB[2, 2], 1.0)) == pytest.approx(tilt, abs=1e-3)


@pytest.mark.parametrize(
    "change, word",
    [
        ({"settings": {"controller": {"gait": {"pace": 1}}}}, "pace"),
        ({"settings": {"controller": {"torso": {"height": "high"}}}}, "torso.height"),
        ({"settings": {"controller": {"gains": {"force_p": [1.0, 2.0]}}}}, "gains.force_p"),
        ({"weights": {"beauty": 1.0}}, "beauty"),
    ],
)
def test_a_wrong_task_file_is_one_clear_sentence(change, word: str) -> None:
    definition = load_task("running_trot")
    content = definition.model_dump()
    for key, value in change.items():
        content[key] = _merge(content[key], value)
    with pytest.raises(UserError, match=word) as error:
        make_task(definition.model_copy(update={k: content[k] for k in change}), MODEL)
    assert "\n" not in str(error.value)


def _merge(old, new):
    return {**old, **{k: _merge(old.get(k, {}), v) for k, v in new.items()}} if isinstance(new, dict) else new


def test_stretches_and_means_over_strides() -> None:
    time = np.arange(8) * 0.5
    assert stretches(time, np.array([0, 1, 1, 0, 0, 1, 0, 1])) == [(0.5, 1.5), (2.5, 3.0), (3.5, 4.0)]
    assert stretches(time, np.zeros(8)) == []
    means = over_strides(np.arange(8.0)[:, None], time, 1.5)
    np.testing.assert_allclose(means[1:7, 0], np.arange(1.0, 7.0))
    assert np.isnan(means[[0, 7], 0]).all()


def found(name: str) -> Path:
    path = FOUND / f"{name}.json"
    if not path.is_file():
        pytest.skip(f"no example parameters of {name}")
    return Path(str(path))


@pytest.mark.parametrize("name", GAITS)
def test_found_parameters_belong_to_their_task(name: str) -> None:
    file = read_parameters(found(name), allow_ungated=True)
    assert file.task == name
    assert set(file.values()) == set(load_task(name).space().names)
    assert set(metric_units(name)) <= set(file.metrics)


def over_cycles(motion: Motion) -> TaskDefinition:
    """The motion's task, as long as CYCLES strides take."""
    stride, start = motion.file.values()["cycle_duration"], 1.2
    return motion.definition.model_copy(update={"duration": start + CYCLES * max(stride, 0.5)})


@pytest.mark.slow
@pytest.mark.parametrize("name", GAITS)
def test_found_gait_keeps_going_and_the_initial_guess_does_not(name: str) -> None:
    """100 unseen perturbed trials of 20 cycles in the full model with estimated state: at least 99 survive with what
    was found, and far fewer with the guess; those of the walks are not bad."""
    motion = load_motion(found(name), MODEL)
    definition = over_cycles(motion)
    evaluation = Evaluation(MODEL, definition, "full", LIBRARY, device_mesh(), 8)
    law = parse_perturbations(definition.perturbations, name, MODEL)
    trials = law.columns(jax.random.key(UNSEEN), SEEDS)
    candidates = np.stack([motion.values, definition.space().initial])
    survived = evaluation.scores(crossed(candidates, *trials)).metrics["survived"].reshape(2, SEEDS).sum(1)
    assert survived[0] >= 99, f"{name}: {survived[0]:.0f} of {SEEDS} survive"
    assert survived[1] < 70, f"{name}: the initial guess survives {survived[1]:.0f} of {SEEDS}"


@pytest.mark.slow
@pytest.mark.parametrize("name", GAITS)
def test_found_gait_goes_as_fast_in_mujoco_c(name: str) -> None:
    motion = load_motion(found(name), MODEL)
    definition, speeds = over_cycles(motion), []  # of the few strides of a search's trial the mean wanders by itself
    for engine in ("moreau", "mujoco_c"):
        score, _ = replay(motion.values, definition, MODEL, "full", engine, LIBRARY)
        assert score.metrics["survived"] == 1.0, engine
        flight = float(score.metrics["flight_fraction"]) * motion.file.values()["cycle_duration"] / 2.0
        assert flight >= LEAST_FLIGHT.get(name, 0.0), engine
        speeds.append(float(score.metrics["heading_speed"]))
    assert speeds[1] == pytest.approx(speeds[0], rel=0.1)
