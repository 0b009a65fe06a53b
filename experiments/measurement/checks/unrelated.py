"""Columns that go with none of the others: another quantity under this name, or a sensor that reads only noise."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from experiments.measurement.checks.links import Column, Columns, Link
from experiments.measurement.checks.matching import Array, Match
from experiments.measurement.checks.repairs import MEASURED
from experiments.measurement.logs.noise_floor import estimated

_UNRELATED: Final = 0.8  # misfit at any gain and delay; a strong effect leaves less
_HARDLY: Final = 0.5  # misfit of other links beside a rate that is unrelated
_HOLDS: Final = 0.1
_MOST_LAG: Final = 60.0  # samples
_LEAST_LINKS: Final = 2
_SAME_QUANTITY: Final = ("rate",)  # links whose two sides are one quantity: one of them tells


def unrelated(links: Sequence[Link], matches: Sequence[Match], columns: Columns, period: float) -> Iterator[Column]:
    """Measured columns that all their links say are wrong, where the columns beside them agree with others.

    `matches`: how well each link holds.
    """
    of: dict[Column, list[tuple[Link, float]]] = defaultdict(list)
    for link, match in zip(links, matches, strict=True):
        for column in link.columns:
            if not _by_the_rest(link, column):
                of[column].append((link, match.misfit))
    for column, mine in of.items():
        enough = len(mine) >= _LEAST_LINKS or mine[0][0].name in _SAME_QUANTITY
        if column[0] not in MEASURED or not enough or min(misfit for _, misfit in mine) <= _HOLDS:
            continue
        others = {other for link, _ in mine for other in link.columns if other in of} - {column}
        apart = [[m for link, m in of[one] if _of_one_joint(link) and column not in link.columns] for one in others]
        holds = [min(misfits) <= _HOLDS for misfits in apart if misfits]
        links_of_it = [link for link, _ in mine]
        if holds and all(holds) and not _at_rest(column, links_of_it, columns, period):
            if _is_unrelated(links_of_it, columns, period):
                yield column


def _at_rest(column: Column, links: Sequence[Link], columns: Columns, period: float) -> bool:
    """Whether a column shows no more than its noise, and the others ask for no more: a spring that bears nothing."""
    shown, mine = columns[column], [link for link in links if link.columns[0] == column]
    return bool(mine) and all(
        max(_beyond_noise(values, link, period) for values in (shown, link.parts(columns)[1][0]))
        < estimated(shown[:, None]) * np.sqrt(_share(link, period))
        for link in mine
    )


def _beyond_noise(values: Array, link: Link, period: float) -> float:
    """RMS in a link's band of what values (T,) or (T, m) hold beside white noise; the largest column's."""
    values = values.reshape(len(values), -1)
    frequency = np.fft.rfftfreq(len(values), period)
    here = (frequency > link.low) & (frequency <= link.high)
    power = 2.0 * (np.abs(np.fft.rfft(values, axis=0)[here]) ** 2).sum(0) / len(values) ** 2
    return float(np.sqrt(max((power - estimated(values) ** 2 * _share(link, period)).max(), 0.0)))


def _share(link: Link, period: float) -> float:
    """Of white noise's variance, what lies in a link's band."""
    return min(2.0 * (link.high - link.low) * period, 1.0)


def _is_unrelated(links: Sequence[Link], columns: Columns, period: float) -> bool:
    misfits = [link.free_match(columns, period, _MOST_LAG).misfit for link in links]
    same = [misfit for link, misfit in zip(links, misfits, strict=True) if link.name in _SAME_QUANTITY]
    return min(same or misfits) > _UNRELATED and min(misfits) > _HARDLY


def _of_one_joint(link: Link) -> bool:
    return len({name for _, name in link.columns}) == 1


def _by_the_rest(link: Link, column: Column) -> bool:
    """Whether a link may hold though this column of it is wrong, because it weighs little there."""
    signal, name = column
    if link.name in ("posture", "stance", "control law", "fingerprint", "current fingerprint"):
        return True
    if link.name == "leg dynamics":
        return link.columns[0][1] != name  # the other joints of a leg bear little on this one's torque
    if link.name == "transmission":
        return signal == "joint_torque"
    return link.name == "motor balance" and signal != "motor_current"
