"""The squat jump's task: its cost terms against closed form."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.errors import UserError
from experiments.imu_sensing import make_sensing
from experiments.model import JointNumbers, Model, nominal_model
from experiments.plant import make_plant
from experiments.tasks.definition import load_task
from experiments.tasks.registry import make_task
from experiments.tasks.squat_jump import leg_lengths
from experiments.trial import NOISE_COLUMNS
from mjx_starleth import robot_numbers

SHIPPED = load_task("squat_jump")
HIP, THIGH, SHANK = 0.0685, 0.200, 0.235  # m, FACTS 1
HIPS = np.array([[0.2525, 0.185, 0], [0.2525, -0.185, 0], [-0.2525, 0.185, 0], [-0.2525, -0.185, 0]])


def test_a_leg_is_as_long_as_from_its_hip_to_its_foot() -> None:
    geometry = make_task(SHIPPED, nominal_model()).settings.geometry
    turn, r_WB = Rotation.from_euler("xyz", [0.3, -0.4, 2.0]), np.array([1.0, -2.0, 0.7])
    # straight; knee at a right angle under the hip; hip turned out, which changes no length
    square = np.hypot(HIP + THIGH, SHANK)
    legs = np.array(
        [[0, 0, -HIP - THIGH - SHANK], [SHANK, 0, -HIP - THIGH], [0, 0, -HIP - THIGH - SHANK], [0, 0, -0.3]]
    )
    legs[2] = Rotation.from_euler("x", 0.4).apply(legs[2])
    feet = r_WB + turn.apply(HIPS + legs)
    q = np.concatenate([r_WB, turn.as_quat()[[3, 0, 1, 2]], np.zeros(12)])
    found = jax.jit(leg_lengths)(geometry, jnp.asarray(q, jnp.float32), jnp.asarray(feet, jnp.float32))
    np.testing.assert_allclose(found, [0.5035, square, 0.5035, 0.3], atol=1e-6)


def test_bodies_drives_and_controller_keep_the_control_period_of_the_robot() -> None:
    numbers = nominal_model().numbers.model_dump(mode="json")
    numbers["loops"]["control_period"] = 5e-3
    model = Model(numbers=robot_numbers(numbers))
    plant, task = make_plant(model), make_task(SHIPPED, model)
    found = (plant.bodies.period, plant.periods.control, task.period, task.settings.control_period)
    np.testing.assert_allclose(found, 5e-3)


def test_a_joint_on_a_bench_has_no_legs_and_the_sentence_says_what_to_do() -> None:
    bench = Model(robot="joint", joint=JointNumbers(name="elbow", kind="revolute", inertia=0.1))
    for make in (make_plant, lambda model: make_task(SHIPPED, model)):
        with pytest.raises(UserError, match=r"has no legs to \w+; give a model of the robot\.$"):
            make(bench)


def test_a_foot_counts_as_on_the_ground_from_the_force_that_the_robot_file_names() -> None:
    numbers = nominal_model().numbers.model_dump(mode="json")
    numbers["contact"]["contact_flag_force"] = 40.0
    model = Model(numbers=robot_numbers(numbers))
    plant = make_plant(model)
    force = jnp.asarray([[0.0, 0.0, 39.0], [0.0, 30.0, 30.0], [0.0, 0.0, 0.0], [0.0, 0.0, 41.0]])
    state = plant.initial_state(plant.params, jnp.asarray(plant.bodies.stance), jnp.zeros(12))
    state, measured = plant.measure(plant.params, state._replace(contact_force=force))
    _, robot, _ = make_sensing("direct", model).step((), state, measured, jnp.zeros(NOISE_COLUMNS))
    np.testing.assert_array_equal(robot.contact, [0, 1, 0, 1])
    others = make_sensing("estimated", model), make_task(SHIPPED, model), make_task(load_task("bound"), model)
    assert [one.contact_force for one in others] == [40.0] * 3


@pytest.mark.parametrize(("before_stop", "charged"), [(0.2, 0.0), (0.06, 0.0), (0.03, 0.02), (-0.01, 0.06)])
def test_joints_are_charged_within_the_software_margin_of_their_stops(before_stop: float, charged: float) -> None:
    task = make_task(SHIPPED, nominal_model())
    joints = np.array([0.0, 0.7, -1.2] * 2 + [0.0, -0.7, 1.2] * 2)
    joints[2] = -2.46 + before_stop  # LF_KFE goes from -2.46 (FACTS 1)
    q = np.float32([0, 0, 0.4, 1, 0, 0, 0, *joints])
    bodies = SimpleNamespace(q=jnp.asarray(q), u=jnp.zeros(18))
    feet = SimpleNamespace(
        r_WF=jnp.zeros((4, 3)),
        contact_force=jnp.zeros((4, 3)),
        slip_velocity=jnp.zeros((4, 3)),
        contact_residual=jnp.zeros(()),
    )
    info = SimpleNamespace(phase=jnp.float32(2.0), tracking_error=jnp.zeros(6), cone_use=jnp.zeros(4))
    tick = SimpleNamespace(
        time=jnp.zeros(()), info=info, after=SimpleNamespace(bodies=bodies), output=SimpleNamespace(bodies=feet)
    )
    found = task.observe(task.first_tally(), tick).joint_stop
    assert float(found) == pytest.approx(charged * task.period, abs=1e-8)


@pytest.mark.parametrize(
    ("outcome", "succeeds"),
    [
        ({}, True),
        ({"rebound": 0.05}, False),
        ({"unrest": 0.03}, False),
        ({"fallen": 0.3}, False),
        ({"touched": 0.0}, False),
    ],
)
def test_what_the_gate_does_not_count_as_success_costs(outcome: dict[str, float], succeeds: bool) -> None:
    task = make_task(SHIPPED, nominal_model())
    whole = {"apex": 0.75, "flight": 0.5, "stance": 2.0, "touched": 1.0} | outcome
    tally = task.first_tally()._replace(**{name: jnp.float32(value) for name, value in whole.items()})
    standing = SimpleNamespace(bodies=SimpleNamespace(q=jnp.full(19, task.settings.landing_height)))
    score = task.score(jnp.zeros(13), tally, jnp.zeros(()), standing)
    assert bool(score.metrics["success"]) == succeeds
    assert float(score.terms["unsuccessful"]) == (0.0 if succeeds else SHIPPED.weights["unsuccessful"])
