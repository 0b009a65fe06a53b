"""One-sentence refusals of numbers that make no sense."""

import math


def check_number(
    what: str, value: float, *, above: float | None = None, at_least: float | None = None, below: float | None = None
) -> None:
    """Raise ValueError unless `value` is a finite number within the limits given."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{what} must be a finite number, not {value!r}")
    if above is not None and not value > above:
        raise ValueError(f"{what} must be above {above:g}, not {value:g}")
    if at_least is not None and not value >= at_least:
        raise ValueError(f"{what} must be at least {at_least:g}, not {value:g}")
    if below is not None and not value < below:
        raise ValueError(f"{what} must be below {below:g}, not {value:g}")


def check_count(what: str, value: int, *, at_least: int = 0) -> None:
    """Raise ValueError unless `value` is a whole number of at least `at_least`."""
    if isinstance(value, bool) or not isinstance(value, int) or value < at_least:
        raise ValueError(f"{what} must be a whole number of at least {at_least}, not {value!r}")
