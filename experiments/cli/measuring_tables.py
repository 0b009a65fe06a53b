"""What `compare` and `learn` say on the terminal: the channels that matter, and the fitted parameters."""

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from experiments.measurement.compare import Comparison
from experiments.model import PlacedEffect

SHOWN = 8  # worst channels of a log


def show_comparison(found: Comparison, before: Comparison | None) -> None:
    """The worst channels on stderr, beside them what the model without its effects leaves."""
    console, table = Console(stderr=True, highlight=False), Table(box=SIMPLE_HEAD, pad_edge=False)
    old = {c.name: c for c in before.channels} if before else {}
    table.add_column("channel", no_wrap=True)
    for name in ("RMS error", *(["× noise without effects"] if before else []), "× noise", "fit %", "whiteness"):
        table.add_column(name, justify="right")
    worst = sorted(found.channels, key=lambda c: -max(c.over_noise, old[c.name].over_noise if c.name in old else 0.0))
    for c in worst[:SHOWN]:
        error, over, fit, white = c.cells()
        was = [f"{old[c.name].over_noise:.2f}" if c.name in old else ""] if before else []
        table.add_row(c.name, error, *was, over, fit, white)
    console.print(found.in_words(), soft_wrap=True)
    console.print(table)


def fitted_lines(effects: Sequence[PlacedEffect], wanted: Sequence[tuple[str, str]]) -> list[str]:
    """One line for each parameter that was fitted."""
    lines = []
    for placed in effects:
        if (placed.effect, placed.where) not in wanted:
            continue
        for name, value in placed.parameters.items():
            lines.append(f"{placed.effect} at {placed.where}: {name} {interval(value.value, value.ci95, value.unit)}")
    return lines


def interval(value: float, ci95: tuple[float, float] | None, unit: str) -> str:
    """`0.0199 rad (95 %: 0.0198 to 0.0200)`."""
    within = f" (95 %: {ci95[0]:.4g} to {ci95[1]:.4g})" if ci95 else ""
    return f"{value:.4g} {unit}{within}"
