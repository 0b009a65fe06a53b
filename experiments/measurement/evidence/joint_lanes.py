"""The replay of a rigid joint with many sets of numbers at once."""

from functools import partial

import jax
import numpy as np

from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.joint_replay import JointLog, JointReplay
from experiments.measurement.evidence.padding import padded

LANES = 16  # sets of numbers per call of the compiled replay
PAD = 2000  # rows, of which logs are made a multiple


def residuals(replay: JointReplay, atoms: Atoms, log: JointLog, still: float, xs: np.ndarray) -> np.ndarray:
    """Unfiltered residual effort (H, T) for atom vectors xs (H, n), LANES at a time through one compiled program."""
    rows = len(log.effort)
    longer = padded(log, PAD)
    found = []
    for i in range(0, len(xs), LANES):
        part = xs[i : i + LANES]
        full = np.concatenate([part, np.repeat(part[-1:], LANES - len(part), 0)]).astype(np.float32)
        found.append(np.asarray(_lanes(replay, atoms, longer, np.float32(still), full))[: len(part), :rows])
    return np.concatenate(found)


@partial(jax.jit, static_argnums=(0, 1))
def _lanes(replay: JointReplay, atoms: Atoms, log: JointLog, still, xs):
    return jax.vmap(lambda x: replay.residual(log, still, atoms.numbers(x)))(xs)
