"""What may have been done to the columns of a log, where links between them do not hold."""

from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Final, NamedTuple

from experiments.measurement.checks import repairs
from experiments.measurement.checks.leg_links import XYZ
from experiments.measurement.checks.links import Column, Columns
from experiments.measurement.checks.repairs import Repair
from mjx_starleth.names import JOINT_NAMES, JOINTS, LEGS

EFFECT_LAGS: Final = tuple(lag for lag in range(-7, 8) if lag)  # samples of delay that an effect may have
_TRIED_LAGS: Final = (-12, 12)  # where the search for a shift starts anyway
# A command stands in a difference in the law that follows it: no lag of the whole law tells how late it is
_COMMAND_LAGS: Final = tuple(lag for lag in range(-60, 61, 6) if lag)
_SEVERAL: Final = 3  # joints that ask for the same before it is tried on all


class Doubts(NamedTuple):
    """Columns of links that do not hold, and for shifts the lags [samples] at which they would, by joint or axis."""

    columns: set[Column]
    lags: Mapping[str, set[int]]

    def names(self, names: tuple[str, ...]) -> list[str]:
        """Those of `names` with a doubtful column."""
        doubtful = {name for _, name in self.columns}
        return [name for name in names if name in doubtful]

    def of_base(self) -> bool:
        return any(signal in repairs.BASE for signal, _ in self.columns)


def of_values(doubts: Doubts, names: tuple[str, ...], there: Columns, gear_ratio: float) -> Iterator[Repair | None]:
    """Exchanged, flipped and rescaled columns of the joints `names` and of the torso."""
    asked: list[Repair] = []
    doubtful = doubts.names(names)
    for name in doubtful:
        asked += [one for signals in repairs.JOINT_GROUPS if (one := repairs.flip(signals, (name,), there))]
        for signals in repairs.UNIT_GROUPS:
            for factor in repairs.known_factors(signals[0], gear_ratio):
                asked += [one for one in [repairs.rescale(signals, (name,), factor, there)] if one]
    yield from asked
    for (kind, signals, value), joints in Counter((one.kind, one.signals, one.value) for one in asked).items():
        if joints >= _SEVERAL:
            sign = kind == "sign"
            yield repairs.flip(signals, names, there) if sign else repairs.rescale(signals, names, value, there)
    yield from _swaps(doubtful, there)
    if doubts.of_base():
        yield from _base_values(there)


def of_time(doubts: Doubts, names: tuple[str, ...], there: Columns) -> Iterator[Repair | None]:
    """Shifted columns of single joints, of all joints and of the torso."""
    every = set(_TRIED_LAGS)
    for name in doubts.names(names):
        lags = _both_ways(doubts.lags.get(name, set()))
        every |= lags
        for signals in repairs.SHIFT_GROUPS:
            for lag in lags:
                yield repairs.shift(signals, (name,), lag, there)
    if doubts.names(names):
        for signals in repairs.SHIFT_GROUPS:
            tried = _COMMAND_LAGS if signals[0] in repairs.COMMANDS else every
            for lag in tried:
                yield repairs.shift(signals, names, lag, there)
    if doubts.of_base():
        asked = set().union(*(doubts.lags.get(name, set()) for name in ("w", *XYZ)))
        for signals in repairs.BASE_GROUPS:
            for lag in _both_ways(asked):
                yield repairs.shift(signals, ("w", *XYZ), lag, there)


def is_effect(repair: Repair) -> bool:
    """Whether a shift is as short as a delay in a sensor or in the answer to a command may be."""
    return abs(repair.value) <= max(EFFECT_LAGS)


def _both_ways(lags: set[int]) -> set[int]:
    """Delays that would mend a link, either of its sides being late."""
    return {side * lag for lag in lags for side in (-1, 1)}.union(_TRIED_LAGS) - {0}


def _swaps(names: list[str], there: Columns) -> Iterator[Repair | None]:
    for one, other in combinations(names, 2):
        for signals in repairs.JOINT_GROUPS:
            yield repairs.swap(signals, one, other, there)
    legs = [leg for leg in LEGS if any(name in JOINT_NAMES and name.startswith(leg) for name in names)]
    for one, other in combinations(legs, 2):
        for signals in repairs.JOINT_GROUPS:
            yield repairs.swap_legs(signals, one, other, JOINTS, there)


def _base_values(there: Columns) -> Iterator[Repair | None]:
    yield from repairs.reorder_quaternion(there)
    for signals in repairs.BASE_GROUPS:
        if len(signals) > 1 or signals == ("base_orientation",):
            continue
        yield repairs.flip(signals, XYZ, there)
        for axis, name in enumerate(XYZ):
            yield repairs.flip(signals, (name,), there)
            yield repairs.swap(signals, name, XYZ[(axis + 1) % 3], there)
        for factor in repairs.known_factors(signals[0], 1.0):
            yield repairs.rescale(signals, XYZ, factor, there)
