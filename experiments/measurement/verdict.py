"""The verdict: is the log explained, by what, how surely, and what is left? (DIAGNOSIS, steps 6 and 'The answer file')."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from experiments.measurement.evidence import Evidence
from experiments.measurement.refit import Placed, Refitted
from experiments.measurement.selection import Selection, best_of_each

Verdict = Literal["explained", "partly_explained", "none", "unknown", "not_identifiable", "data_fault"]

FLOOR = 1.15  # residual over noise up to which a channel counts as explained
FOUND_SHARE = 0.7  # of the excess over the floor that the effects must take away to be believed
COVERAGE = 1.96


@dataclass(frozen=True)
class Misfit:
    """Residual over noise: by drive channel and joint (3, J), by body channel (26,), NaN where nothing was measured."""

    drive: np.ndarray | None
    body: np.ndarray | None

    @property
    def worst(self) -> float:
        """The largest of all."""
        parts = [x[np.isfinite(x)] for x in (self.drive, self.body) if x is not None]
        values = np.concatenate([p.ravel() for p in parts]) if parts else np.zeros(1)
        return float(values.max()) if len(values) else 0.0


def misfit(log: Evidence, fit: Refitted, index: int) -> Misfit:
    """Residual over noise of one log at a fit; constant errors below the model's own are not counted."""
    point = fit.points[index]
    drive = body = None
    if log.drive is not None:
        drive = np.sqrt((log.drive_residual([point])[0] ** 2).mean(0)).T
    if log.body is not None:
        r, used = log.body_residual([point])[0], log.body.used
        count = used.sum(0)
        # smoothed rows share their noise: what is slower than the filter is weighed as it deserves
        size = np.sqrt((r**2).sum(0) / np.maximum(count, 1))
        body = np.where(count > 20, size, np.nan)
    return Misfit(drive, body)


def excess(logs: Sequence[Evidence], fit: Refitted) -> float:
    """How far chi^2 lies above its floor, per residual."""
    points = sum(log.weight().sum() for log in logs)
    return max(fit.total / points - 1.0, 0.0)


def unexplained(logs: Sequence[Evidence], selection: Selection) -> float:
    """Share of the nominal model's excess that the fit leaves."""
    before, after = excess(logs, selection.ladder[0][1]), excess(logs, selection.fit)
    return after / before if before > 0 else 0.0


def decide(logs: Sequence[Evidence], selection: Selection) -> tuple[Verdict, tuple[Placed, ...]]:
    """The verdict and the effects that it names."""
    left = max(misfit(log, selection.fit, i).worst for i, log in enumerate(logs))
    effects = selection.fit.effects
    if not effects:
        return ("none" if left <= FLOOR * 1.3 else "unknown"), ()
    share = 1.0 - unexplained(logs, selection)
    if share < FOUND_SHARE:
        return "unknown", ()
    if any(selection.ties):
        return "not_identifiable", effects
    return ("explained" if left <= 1.5 * FLOOR else "partly_explained"), effects


def effect_entries(
    selection: Selection, logs: Sequence[Evidence], units: dict[tuple[str, str], str]
) -> list[dict[str, Any]]:
    """`effects` of the answer file, in the order added."""
    found, first = [], 0
    for k, placed in enumerate(selection.fit.effects):
        parameters = {}
        for name, value in placed.parameters.items():
            half = COVERAGE * float(np.sqrt(max(selection.fit.covariance[first, first], 0.0)))
            parameters[name] = {
                "value": value,
                "ci95": [value - half, value + half],
                "unit": units[placed.effect, name],
            }
            first += 1
        before, after = selection.ladder[k][1], selection.ladder[k + 1][1]
        found.append(
            {
                "effect": placed.effect,
                "where": placed.where,
                "parameters": parameters,
                "held_out_error_before": _error(logs, before, placed),
                "held_out_error_after": _error(logs, after, placed),
            }
        )
    return found


def _error(logs: Sequence[Evidence], fit: Refitted, placed: Placed) -> float:
    return max(misfit(log, fit, i).worst for i, log in enumerate(logs))


def ranking_entries(selection: Selection) -> list[dict[str, Any]]:
    """`ranking` of the answer file: each effect at its best place, by its first score."""
    if not selection.rankings:
        return []
    return [
        {"effect": s.effect.name, "where": s.where, "score": round(s.gain, 3)}
        for s in best_of_each(selection.rankings[0])
        if s.gain > 0
    ]
