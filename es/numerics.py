"""Strictness is for our own code: libraries that mix ranks and dtypes freely are called inside this."""

import contextlib
from collections.abc import Iterator

import jax


@contextlib.contextmanager
def library_numerics() -> Iterator[None]:
    """Allow rank and dtype promotion, whatever the process has set for its own code."""
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        yield
