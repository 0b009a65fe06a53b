"""Columns that go with none of the others: another quantity under this name, or a sensor that reads only noise."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Final

from experiments.measurement.links import Column, Columns, Link
from experiments.measurement.matching import Match
from experiments.measurement.repairs import MEASURED

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
        if holds and all(holds) and _is_unrelated([link for link, _ in mine], columns, period):
            yield column


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
