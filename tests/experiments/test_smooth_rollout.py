"""Smooth laws against the hard ones and against finite differences; the slope of a whole smooth rollout."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import experiments
from experiments.effects import LIBRARY
from experiments.model import nominal_model
from experiments.parameter_file import read_parameters
from experiments.rollout import Rollout
from experiments.smooth.contact import smooth_contacts
from experiments.smooth.drive import smooth_drive
from experiments.smooth.gait_task import SmoothGait
from experiments.smooth.laws import WIDTHS, Widths, clip, shrink_to, softplus
from experiments.smooth.rollout import cost_and_slope, smooth_rollout
from experiments.tasks.definition import load_task
from experiments.trial import nominal_trial
from mjx_starleth.contact import ContactProblem, solve_contacts
from sea_jax import DRIVES, JointCommand, JointMeasurement, JointMotion, initial_state, params_from_numbers

SLOPE_ERROR = 0.01  # relative; what a slope is worth having for
STEP = 1e-6  # of a range or unit, in float64: rounding 1e-10, curvature far below 1 % (measured 4e-4)
# A jump of an earlier search with the full drive train: it flies, lands and stands.
JUMP = [0.227, 0.273, 0.436, 0.541, 0.291, 0.428, 0.259, 0.251, 0.252, 0.441, 0.47, 0.389, 389.0]
NARROW = Widths(*(0.01 * width for width in WIDTHS))


@pytest.fixture
def float64():
    """Finite differences need it; the house's strictness about types is for float32."""
    with jax.enable_x64(True), jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


def wide(tree):
    """All numbers of a pytree in float64."""

    def one(x):
        x = jnp.asarray(x)
        return x.astype(jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x

    return jax.tree.map(one, tree)


def against_differences(function, x: np.ndarray, steps: np.ndarray) -> float:
    """Relative error of a function's slopes by forward mode, scaled with the steps."""
    count, along = len(x), jnp.diag(steps)
    shift, still = along * STEP, jnp.zeros_like(along)
    points, ways = x + jnp.concatenate([still, shift, -shift]), jnp.concatenate([along, still, still])
    # slopes and values of one program
    values, slopes = jax.jit(jax.vmap(lambda p, way: jax.jvp(function, (p,), (way,))))(points, ways)
    exact, differences = slopes[:count], (values[count : 2 * count] - values[2 * count :]) / (2 * STEP)
    return float(jnp.linalg.norm(exact - differences) / jnp.linalg.norm(differences))


def contact_problem(free: np.ndarray) -> ContactProblem:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 6, 3)) * 0.3
    own = np.eye(3)[None] * np.array([2.0, 3.0, 2.5, 1.5])[:, None, None]
    return ContactProblem(root, own, free, np.full(4, 0.8), np.ones(4))


FREE = np.array([[0.1, 0.0, -1.0], [0.05, -0.1, -0.6], [1.5, 0.2, -0.5], [0.1, 0.0, 0.8]])  # stick, stick, slip, off


def test_smooth_contact_tends_to_the_hard_laws(float64) -> None:
    """The foot that slips may differ: its friction is the sticking force brought into the disc."""
    problem = contact_problem(FREE)._replace(root=np.zeros((4, 6, 3)))
    hard, _ = jax.jit(solve_contacts)(wide(problem), jnp.zeros((4, 3)))
    smooth, _ = jax.jit(smooth_contacts(NARROW))(wide(problem), jnp.zeros((4, 3)))
    np.testing.assert_allclose(smooth[jnp.array([0, 1, 3])], hard[jnp.array([0, 1, 3])], atol=2e-3)
    assert float(jnp.linalg.norm(smooth[2, :2])) <= 0.8 * float(smooth[2, 2])


def test_smooth_contact_has_the_slope_of_its_differences(float64) -> None:
    solve = smooth_contacts(WIDTHS)

    def impulse(x):
        problem = wide(contact_problem(FREE))._replace(free_velocity=x.reshape(4, 3))
        return solve(problem, jnp.zeros((4, 3)), 3)[0].ravel()

    assert against_differences(impulse, jnp.asarray(FREE.ravel()), np.ones(12)) < SLOPE_ERROR


def driven(drive, params, torque, position_mode=0.0):
    """Spring torques after 20 control periods of one command."""
    zero = jnp.zeros(12)
    motion = JointMotion(zero, zero, zero, zero)

    def period(state, _):
        drive_state, shown = state
        measurement = JointMeasurement(zero, zero, shown, drive_state.motor_position)
        command = JointCommand(torque, zero, jnp.full(12, position_mode))
        after, output = drive(params, drive_state, (command, measurement, motion))
        return (after, output.end_torque), output.end_torque

    start = initial_state(params, zero, zero, {})
    return jax.lax.scan(period, wide((start, zero)), None, length=20)[1].ravel()


def test_smooth_drive_tends_to_the_cheap_one_and_has_the_slope_of_its_differences(float64) -> None:
    params = wide(params_from_numbers(nominal_model().numbers.model_dump(mode="json")))
    torque = jnp.asarray(np.tile([5.0, -12.0, 8.0, -4.0, 3.0, 20.0], 2))
    torque = torque * jnp.where(params.spring_side < 0, -1.0, 1.0)  # knees off their stops, where slopes explode
    smooth = smooth_drive(WIDTHS)
    hard, soft = driven(DRIVES["cheap"], params, torque), driven(smooth_drive(NARROW), params, torque)
    assert float(jnp.abs(hard - soft).max()) < 0.05 * float(jnp.abs(hard).max())
    assert against_differences(lambda t: driven(smooth, params, t), torque, np.full(12, 10.0)) < SLOPE_ERROR


def test_rounded_laws() -> None:
    x = jnp.linspace(-5.0, 5.0, 41)
    np.testing.assert_allclose(softplus(x, 0.01), jnp.maximum(x, 0.0), atol=0.01)
    np.testing.assert_allclose(clip(x, -1.0, 2.0, 0.01), jnp.clip(x, -1.0, 2.0), atol=0.01)
    length = jnp.array([1e-12, 0.5, 2.0, 1e9])
    factor = shrink_to(length, jnp.full(4, 1.0))
    assert np.all(length * factor <= 1.0 + 1e-6) and factor[0] == pytest.approx(1.0)
    # a foot in the air: no force, no limit, and still a finite slope
    slope = jax.grad(lambda a: shrink_to(a, jnp.float32(1e-30)))(jnp.float32(1.0))
    assert np.isfinite(slope)


def example(task: str) -> np.ndarray:
    """Values (n,) of a motion that was found."""
    if task == "squat_jump":
        return np.array(JUMP)
    file = read_parameters(Path(experiments.__file__).parent / "examples" / f"{task}.json", allow_ungated=True)
    return load_task(task).space().vector(file.values())


def in_float64(task, **changes):
    """A task whose numbers are in float64."""

    class InFloat64(type(task)):
        def start(self, *arguments):
            return wide(super().start(*arguments))

    fields = {field.name: getattr(task, field.name) for field in dataclasses.fields(task)}
    return InFloat64(**fields | {"settings": wide(task.settings)} | changes)


def started_at(task, point):
    """A gait that starts its stride where it would with the values `point`: its slope holds that state."""
    if not isinstance(task, SmoothGait):
        return task
    state = task.start
    held = dataclasses.replace(task)
    object.__setattr__(
        held, "start", lambda plant, params, settings, _, trial: state(plant, params, settings, point, trial)
    )
    return held


@pytest.mark.slow
@pytest.mark.parametrize("task", ["squat_jump", "walking_trot"])
def test_the_slope_of_a_whole_rollout_is_that_of_its_differences(task: str, float64) -> None:
    """Over all of the smooth rollout's ticks, for the initial guess and a motion that was found."""
    definition = load_task(task)
    loop = smooth_rollout(nominal_model(), definition, LIBRARY)
    changes = {}
    if isinstance(loop.task, SmoothGait):
        before = loop.task.before
        changes["before"] = Rollout(before.plant, in_float64(before.task), before.sensing)
    motion, params, space = in_float64(loop.task, **changes), wide(loop.plant.params), definition.space()

    def cost(values, start):
        held = Rollout(loop.plant, started_at(motion, start), loop.sensing)
        return held.score(params, motion.settings, values, nominal_trial()).cost

    def slope(values):
        return cost_and_slope(
            Rollout(loop.plant, motion, loop.sensing), params, motion.settings, values, nominal_trial()
        )[1]

    points = jnp.asarray(np.stack([space.initial, example(task)]), jnp.float64)
    slopes = jax.jit(jax.vmap(slope))(points)
    costs = jax.jit(jax.vmap(cost, in_axes=(0, None)))
    for point, exact in zip(points, slopes, strict=True):
        there = jnp.diag(jnp.asarray(space.scale)) * STEP
        both = costs(jnp.concatenate([point + there, point - there]), point)
        differences = (both[: space.size] - both[space.size :]) / (2 * STEP)
        error = np.linalg.norm(exact * space.scale - differences) / np.linalg.norm(differences)
        print(f"{task}: relative error {error:.1e}, slope {np.linalg.norm(differences):.2f} per range")
        assert error < SLOPE_ERROR
