"""`python tests/data/record_jumps.py`: problems that the controller and the bodies meet in three squat jumps.

Writes beside itself `jump_distributions.npz` (inputs of the force distribution, tick by tick, flights included) and
`jump_contacts.npz` (states and inputs of the bodies' step with feet on the ground: evenly spread ticks, and those
that left the largest contact residuals). The jumps, with the full drive: a tuned one; the same with a push on the
slippery ground of 0.5; an untuned one with a push and sensor noise.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from experiments.imu_sensing import make_sensing
from experiments.model import load_model
from experiments.plant import make_plant
from experiments.rollout import Rollout, Score, Tick
from experiments.tasks.definition import load_task
from experiments.tasks.registry import make_task
from experiments.trial import Trial, noise_table

TUNED = [0.2317, 0.2785, 0.4507, 0.5483, 0.2337, 0.4151, 0.2638, 0.4509, 0.3731, 0.4307, 0.4592, 0.3862, 396.3]
FIRST, LAST = 100, 660  # ticks: the end of the crouch to 0.5 s after touch-down
EVEN, WORST = 300, 100  # contact ticks
HERE = Path(__file__).parent
NUMBERS = {
    "push_x": np.float32([0.0, 60.0, 40.0]),
    "push_y": np.float32([0.0, 40.0, -40.0]),
    "push_start": np.float32([0.0, 0.4, 0.4]),
    "push_duration": np.float32([0.0, 0.2, 1.0]),
    "ground_friction": np.float32([1.0, 0.625, 1.0]),
    "sensor_noise": np.float32([0.0, 0.0, 1.0]),
}  # of the trials


def main() -> None:
    score, ticks = jumps()
    print("apex, m:", np.round(score.metrics["apex_height"], 3))
    save_distributions(ticks)
    save_contacts(ticks)


def jumps() -> tuple[Score, Tick]:
    """The three jumps, and their ticks from FIRST to LAST one jump after the other."""
    model, definition = load_model(None), load_task("squat_jump")
    rollout = Rollout(make_plant(model), make_task(definition, model), make_sensing("direct", model))
    noise = noise_table()

    def jump(values, numbers, start):
        return rollout.record(rollout.plant.params, rollout.task.settings, values, Trial(numbers, noise, start))

    values = jnp.float32([TUNED, TUNED, definition.space().initial])
    score, ticks = jax.jit(jax.vmap(jump))(values, NUMBERS, jnp.int32([0, 0, 0]))
    return score, jax.tree.map(lambda x: np.asarray(x)[:, FIRST:LAST].reshape(-1, *x.shape[2:]), ticks)


def save_distributions(ticks: Tick) -> None:
    """All ticks as inputs of the force distribution."""
    grounded = ticks.info.support.max(-1) > 0
    np.savez_compressed(
        HERE / "jump_distributions.npz",
        q=ticks.robot.q,
        R_WB=ticks.robot.R_WB,
        load=ticks.info.support,
        wrench=ticks.info.desired_wrench,
    )
    print(f"{grounded.sum()} distributions in {len(grounded)} ticks")


def save_contacts(ticks: Tick) -> None:
    """Some ticks with feet on the ground as inputs of the bodies' step."""
    before, output = ticks.before.bodies, ticks.output
    touching = np.flatnonzero((output.bodies.contact_force[..., 2] > 0).any(-1))
    worst = touching[np.argsort(output.bodies.contact_residual[touching])[-WORST:]]
    even = touching[np.linspace(0, len(touching) - 1, EVEN).astype(int)]
    chosen = np.unique(np.concatenate([even, worst]))

    of_tick = {name: np.repeat(values, LAST - FIRST)[chosen] for name, values in NUMBERS.items()}
    since = ticks.time[chosen] - of_tick["push_start"]
    pushed = (since >= 0) & (since < of_tick["push_duration"])
    np.savez_compressed(
        HERE / "jump_contacts.npz",
        q=before.q[chosen],
        u=before.u[chosen],
        impulse=before.impulse[chosen],
        joint_torque=output.drive.torque[chosen],
        joint_damping=output.drive.damping[chosen],
        push=np.stack([of_tick["push_x"], of_tick["push_y"]], -1) * pushed[:, None],
        friction=0.8 * of_tick["ground_friction"],
    )
    quantiles = np.quantile(output.bodies.contact_residual[touching], [0.5, 0.99, 0.999, 1.0])
    print(f"contact residuals of all {len(touching)} ticks, N: median, 99 %, 99.9 %, largest {np.round(quantiles, 4)}")


if __name__ == "__main__":
    main()
