"""Fits that do not need each other, on all cores: one fit asks for one replay at a time, which keeps one core busy."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from experiments.measurement.evidence.turns import replay_devices

Item, Found = TypeVar("Item"), TypeVar("Found")


def side_by_side(fit: Callable[[Item], Found], items: Iterable[Item]) -> list[Found]:
    """`fit` of each item, in their order. Raises what the first of them raises."""
    with ThreadPoolExecutor(len(replay_devices())) as pool:
        return list(pool.map(fit, items))
