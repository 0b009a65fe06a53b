"""What every report of a tuned motion says of its parameter file: figures, the run in a line, values, provenance."""

from collections.abc import Mapping

from experiments.parameter_schema import ParameterFile
from experiments.reports.numbers import minus, number, percent
from experiments.reports.page import Block, Card, Code, Columns, Range, Table

Headlines = Mapping[str, tuple[str, float, str, str]]
"""Metric -> label, factor to the unit shown, unit shown, format."""


def metric_cards(file: ParameterFile, headlines: Headlines) -> list[Card]:
    """Those of the metrics that the file has, with their spread over the perturbed trials."""
    trials = f"over {file.perturbed.trials} perturbed trials" if file.perturbed else ""
    cards = []
    for name, (label, factor, unit, form) in headlines.items():
        metric = file.metrics.get(name)
        if metric is None:
            continue
        spread = metric.spread
        if isinstance(metric.value, bool):
            note = f"{percent(spread.mean)} {trials}" if spread else ""
            tone = "good" if metric.value else "bad"
            cards.append(Card(label, "yes" if metric.value else "no", note=note, tone=tone))
        else:
            note = f"{factor * spread.mean:{form}} ± {factor * spread.std:{form}} {trials}" if spread else ""
            cards.append(Card(label, minus(f"{factor * metric.value:{form}}"), unit, minus(note)))
    return cards


def gate_card(file: ParameterFile) -> list[Card]:
    """The verdict of the robustness gate, if there was one."""
    gate = file.robustness_gate
    if gate is None:
        return []
    shown, required = percent(gate.ci95[0], 1), percent(gate.required, 1)
    note = f"{gate.trials} trials show at least {shown} with 95 % confidence; required {required}"
    return [Card("Robustness gate", percent(gate.success_rate, 1), note=note, tone="good" if gate.passed else "bad")]


def one_line(file: ParameterFile) -> str:
    """Robot, drive, size of the search, seed, model and day."""
    size = [str(file.search[name]) for name in ("generations", "population") if name in file.search]
    facts = [
        file.robot,
        f"{file.drive} drive",
        *([" × ".join(size) + " candidates"] if size else []),
        f"seed {file.seed}",
        f"model {file.model_hash[:12]}",
        file.created[:10],
    ]
    return " · ".join(facts)


def parameter_table(file: ParameterFile) -> Table:
    """Values, units, and where they lie between their bounds."""
    rows = [
        [p.name, number(p.value, 4), p.unit, number(p.low), Range(p.value, p.low, p.high), number(p.high)]
        for p in file.parameters
    ]
    caption = "The parameters. A red mark is a value at one of its bounds: widening them may pay."
    return Table(["Parameter", "Value", "Unit", "Low", "", "High"], rows, caption, numeric=(1, 3))


def provenance(file: ParameterFile) -> list[Block]:
    """The command that replays the motion, and all that decided the result."""
    facts = [
        ("Task", file.task),
        ("Robot", file.robot),
        ("Model", file.model_hash),
        ("Drive", file.drive),
        ("Seed", str(file.seed)),
        *((f"Search: {name}", number(v) if isinstance(v, float) else str(v)) for name, v in file.search.items()),
        ("Created (UTC)", file.created),
        ("Checksum of parameters.json", file.checksum),
    ]
    versions = [[name, version] for name, version in file.versions.items()]
    computed = [Table(["Package", "Version"], versions, "What it was computed with.")]
    if file.perturbed is not None:
        rows = [[name, about] for name, about in file.perturbed.perturbations.items()]
        trials = f"the {file.perturbed.trials} trials behind the spreads (seed {file.perturbed.seed})"
        computed.append(Table(["Perturbation", "How much"], rows, f"What was perturbed in {trials}."))
    return [Code(file.command), Columns([[Table(["", "This run"], facts, "What decides the result.")], computed])]
