"""The answer file of `starleth diagnose`: the same keys whatever the verdict."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

DATA_FAULT: Final = "data_fault"  # beside the verdicts on logs that can be believed

Entries = Sequence[Mapping[str, Any]]


def answer_of(
    verdict: str,
    text: str,
    next_experiment: str,
    effects: Entries = (),
    tied_with: Sequence[Sequence[str]] = (),
    held_out_rms: float | None = None,
    unexplained_fraction: float = 1.0,
    ranking: Entries = (),
    refuted: Entries = (),
    unsteady: Entries = (),
    rest_goes_with: Entries = (),
) -> dict[str, Any]:
    """The answer as JSON values; what is left out was not found, as in a log that cannot be diagnosed.

    held_out_rms: of all residuals over noise on held-out blocks; None where nothing was fitted.
    """
    return {
        "verdict": verdict,
        "text": text,
        "effects": list(effects),
        "tied_with": list(tied_with),
        "next_experiment": next_experiment,
        "held_out_rms": None if held_out_rms is None else round(held_out_rms, 4),
        "unexplained_fraction": round(unexplained_fraction, 4),
        "ranking": list(ranking),
        "refuted": list(refuted),
        "unsteady": list(unsteady),
        "rest_goes_with": list(rest_goes_with),
    }
