"""Logs made longer, so that logs of like length share one compiled program."""

from typing import TypeVar

import numpy as np

Log = TypeVar("Log", bound=tuple)


def padded(log: Log, multiple: int) -> Log:
    """A log (a named tuple of tables, rows first) whose last row is repeated up to a multiple of rows."""
    return type(log)(*(np.concatenate([t, np.repeat(t[-1:], -len(t) % multiple, axis=0)]) for t in log))
