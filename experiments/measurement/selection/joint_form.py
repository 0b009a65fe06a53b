"""Would one unknown function of the position or of the speed explain a rigid joint better than the effects named?

Effects of the library may imitate a law that it does not have: a gravity load and a friction that differs by direction
look like a cable that hardens. The imitation takes several effects and still leaves more than the law itself, written
as free straight pieces over the one state that it depends on.
"""

from collections.abc import Sequence

import numpy as np

from experiments.measurement.evidence.joint_evidence import JointEvidence
from experiments.measurement.fits.fit_types import Nominal, Refitted

KNOTS = 7  # of the free function
ENDS = (1.0, 99.0)  # per cent of the rows between which they lie
BENT = 1.0  # floors by which neighbouring pieces may differ in slope without being asked why
CLEAR = 40.0  # fall of chi^2 on held-out blocks, as for an effect
MORE = 0.5  # of what the effects leave over the noise: a law that leaves less is what they imitate


def imitated(
    logs: Sequence[JointEvidence],
    nominal: Sequence[Nominal],
    without: Refitted,
    found: Refitted,
    train: Sequence[np.ndarray],
) -> str | None:
    """The state, `position` or `speed`, whose unknown function explains held-out blocks better than the effects do.

    without, found: fits to the blocks `train` without effects and with those named. None where they stand.
    """
    noise = sum((log.weight() * ~mask).sum() for log, mask in zip(logs, train, strict=True))
    named = sum((chi2 * ~mask).sum() for chi2, mask in zip(found.chi2, train, strict=True))
    for state in ("position", "speed"):
        free = sum(_free(log, nominal, without, i, train[i], state) for i, log in enumerate(logs))
        if named - free > CLEAR and free - noise < MORE * (named - noise):
            return state
    return None


def _free(
    log: JointEvidence, nominal: Sequence[Nominal], without: Refitted, index: int, train: np.ndarray, state: str
) -> float:
    """chi^2 of the blocks that a free function of the state was not fitted to, nominal numbers fitted beside it."""
    start = without.points[index]
    steps = [_deviation(log, n) for n in nominal]
    moved = log.residual([start, *(start._replace(x=start.x + step) for step in steps)])
    pieces = _pieces(log.log.position if state == "position" else log.log.velocity)[:, : log.rows]
    pieces = log.filter.thinned(pieces) / log.floor * log.used
    columns = np.concatenate([pieces, moved[1:] - moved[:1]])
    bends = np.diff(np.eye(len(columns))[:KNOTS], 2, axis=0) / (BENT * log.floor)
    prior = bends.T @ bends + np.diag(np.r_[np.full(KNOTS, 1e-6), 1e-6, np.ones(len(steps))])
    here = train[log.part.block]
    solution = np.linalg.solve(columns[:, here] @ columns[:, here].T + prior, columns[:, here] @ moved[0][here])
    return float(((moved[0] - solution @ columns)[~here] ** 2).sum())


def _deviation(log: JointEvidence, n: Nominal) -> np.ndarray:
    """A nominal number one deviation off, as a step of x."""
    chosen = log.atoms.selection(n.effect, n.where)
    k = [c.parameter.name for c in log.atoms.of(n.effect)].index(n.parameter)
    return chosen[:, k] * n.deviation


def _pieces(x: np.ndarray) -> np.ndarray:
    """Hat functions (KNOTS, T) over x (T,), constant beyond the ends, and a step for what jumps with the sign."""
    x = np.asarray(x, float)
    knots = np.linspace(*np.percentile(x, ENDS), KNOTS)
    return np.concatenate([[np.interp(x, knots, hat) for hat in np.eye(KNOTS)], np.sign(x)[None]])
