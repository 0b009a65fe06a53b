"""Replays that were run before: a fit asks for the same numbers again and again."""

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock

import numpy as np

MOST = 128  # replays kept; one of 8 s takes half a megabyte


class Remembered:
    """Rows of numbers (H, n) to what a function makes of each, which is asked only for those that are new.

    Several threads may ask at once; what both ask for at the same time is run twice.
    """

    def __init__(self) -> None:
        self._known: OrderedDict[bytes, np.ndarray] = OrderedDict()
        self._lock = Lock()

    def ask(self, keys: np.ndarray, run: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Results (H, …) for keys (H, n). `run` gets the indices (m,) of the keys to run, and returns (m, …)."""
        names = [key.tobytes() for key in np.ascontiguousarray(keys)]
        with self._lock:
            found = {name: self._known[name] for name in names if name in self._known}
        fresh: dict[bytes, int] = {}
        for i, name in enumerate(names):
            if name not in found:
                fresh.setdefault(name, i)
        if fresh:
            found |= dict(zip(fresh, run(np.array(list(fresh.values()))), strict=True))
        with self._lock:
            for name in names:
                self._known[name] = found[name]
                self._known.move_to_end(name)
            while len(self._known) > MOST:
                self._known.popitem(last=False)
        return np.stack([found[name] for name in names])
