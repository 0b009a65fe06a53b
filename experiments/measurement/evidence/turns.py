"""Devices that replays take turns on. Several threads may ask for replays at once, most for a few at a time."""

import itertools
import os

import jax

_first = itertools.count()


def replay_devices() -> list[jax.Device]:
    """Those that there are cores for: virtual ones beyond them would only be compiled for."""
    found = jax.local_devices()
    if found[0].platform != "cpu" or not hasattr(os, "sched_getaffinity"):
        return found
    return found[: len(os.sched_getaffinity(0))]


def next_devices(most: int) -> list[jax.Device]:
    """`most` of them or all, whichever is less, first the one after the first one of the last call."""
    found = replay_devices()
    first = next(_first) % len(found)
    return [*found[first:], *found[:first]][:most]
