"""A rigid joint on a bench: efforts in closed form for a given motion, so that what is hidden is known exactly."""

import numpy as np

from experiments.effects.bench import GRAVITY_LOAD
from experiments.effects.library import LIBRARY
from experiments.measurement.logs.log import BenchJoint, Log, SignalTable

PERIOD = 1e-3
ROWS = 8000
INERTIA, VISCOUS, GRAVITY = 0.3, 0.4, 2.0
COULOMB, BIAS = 0.35, 0.12  # N m that the model does not know of
ENCODER, TORQUE = 2e-6, 0.02  # rad, N m of noise
SILENT = lambda text: None  # noqa: E731
GEARED = dict(LIBRARY) | {GRAVITY_LOAD.name: GRAVITY_LOAD}


def bench_log(coulomb: float = 0.0, bias: float = 0.0, cable: float = 0.0, start: float = 0.0) -> Log:
    """A sum of sines; J a + b v + G sin q + coulomb sgn v + bias |v| + cable (q + q^3), held for a row each."""
    rng = np.random.default_rng(5)
    time = start + np.arange(ROWS) * PERIOD
    tones = [(0.9, 0.31), (0.5, 0.77), (0.2, 1.9), (0.08, 3.3)]

    def course(t, k):
        terms = [a * (2 * np.pi * f) ** k * np.sin(2 * np.pi * f * t + f + k * np.pi / 2) for a, f in tones]
        return np.sum(terms, 0)

    middle = time + 0.5 * PERIOD  # the effort is held from this row to the next
    q, v, a = (course(middle, k) for k in range(3))
    effort = INERTIA * a + VISCOUS * v + GRAVITY * np.sin(q) + coulomb * np.sign(v) + bias * np.abs(v)
    effort += cable * (q + q**3)
    table = lambda x: SignalTable(("axis",), x[:, None])  # noqa: E731
    signals = {
        "joint_position": table(course(time, 0) + ENCODER * rng.standard_normal(ROWS)),
        "applied_torque": table(effort + TORQUE * rng.standard_normal(ROWS)),
    }
    joint = BenchJoint(name="axis", inertia=INERTIA, viscous_friction=VISCOUS, gravity_load=GRAVITY)
    noise = {"joint_position": ENCODER, "applied_torque": TORQUE}
    return Log("joint", "bench", PERIOD, noise, joint, time, signals, name=f"bench_{start:g}")
