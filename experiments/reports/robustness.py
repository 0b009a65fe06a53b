"""The report of `starleth robustness`: how often a motion succeeds, what makes it fail, how near the limits are."""

from pathlib import Path
from typing import Final

import numpy as np
import plotly.graph_objects as go

from experiments.reports.figures import BLUE, FORBIDDEN, GREEN, GREY, ORANGE, RED, faded, new_figure
from experiments.reports.numbers import number, percent
from experiments.reports.page import Block, Card, Cards, Code, Figure, Section, Table, Text, write_report
from experiments.robustness.file import RobustnessFile, Sensitivity, SurvivalCurve
from experiments.robustness.statistics import dependence
from experiments.robustness.store import DRAWN
from experiments.robustness.store import Table as Trials

CURVES: Final = 12  # the disturbances that matter most get a curve
COLUMNS: Final = 3
CLOUD: Final = 2000  # dots that a page can show without becoming slow
ONE_SIDED: Final = 0.1  # rank correlation from which more and less differ
SURELY: Final = 1e-3  # p value from which a rank is no accident


def write_robustness_report(path: Path, file: RobustnessFile, sample: Trials) -> None:
    """One HTML file. `sample`: the trials that the file's statistics were taken over. Raises UserError."""
    sections = [
        Section("Result", [_cards(file), Text(_summary(file), "lead" if file.successes else "warning")]),
        Section("Survival over the disturbance", _survival(file)),
        Section("Which perturbation matters", _sensitivity(file, sample)),
        Section("Margins to the limits", _margins(file)),
        Section("Worst cases", _worst(file)),
        Section("How to repeat it", _provenance(file)),
    ]
    title = f"Robustness of {file.task.replace('_', ' ')}"
    line = f"{file.robot} · {file.drive} drive · {file.trials} trials · seed {file.seed} · model {file.model_hash[:12]}"
    write_report(path, title, line, sections)


def _cards(file: RobustnessFile) -> Cards:
    low, high = file.ci95
    cards = [
        Card(
            "Success",
            percent(file.success_rate, 2),
            note=f"95 %: {percent(low, 2)} to {percent(high, 2)}",
            tone="good" if low >= 0.95 else "plain" if low >= 0.5 else "bad",
        ),
        Card("Trials", str(file.trials), note=f"{file.trials - file.successes} failed"),
        Card("Cost", number(file.metrics["cost"].p50), note=f"5 to 95 %: {_range(file.metrics['cost'])}"),
    ]
    if "apex_height" in file.metrics:
        apex = file.metrics["apex_height"]
        cards.append(Card("Apex", f"{apex.p50:.3f}", "m", f"5 to 95 %: {_range(apex)} m"))
    if file.gate is not None:
        word = "passed" if file.gate.passed else "failed"
        note = f"required: at least {percent(file.gate.required, 1)} of the trials, with 95 % confidence"
        cards.append(Card("Robustness gate", word, note=note, tone="good" if file.gate.passed else "bad"))
    return Cards(cards)


def _range(spread) -> str:
    return f"{number(spread.p05)} to {number(spread.p95)}"


def _summary(file: RobustnessFile) -> str:
    text = f"{file.successes} of {file.trials} trials succeed."
    strong = [s.name for s in file.sensitivity if s.p_value < SURELY][:3]
    if strong:
        text += f" What decides the cost most: {', '.join(strong)}."
    narrow = min(file.margins.items(), key=lambda item: item[1].p05)
    left = f"{number(narrow[1].p05)} {_unit(narrow[1].unit)}".strip()
    text += f" Closest to its limit in the trials that succeed: {_margin_name(narrow[0])}"
    return f"{text} ({left} left, 5 % quantile)."


def _survival(file: RobustnessFile) -> list[Block]:
    if not file.survival:
        return [Text("Nothing varied from trial to trial.")]
    curves = sorted(file.survival, key=lambda c: dependence(np.array(c.trials), np.array(c.successes)))[:CURVES]
    rows = -(-len(curves) // COLUMNS)
    titles = [f"{curve.name} [{curve.unit}]" for curve in curves]
    spacing = {"vertical_spacing": 0.34 / rows, "horizontal_spacing": 0.06}
    figure = new_figure(rows, COLUMNS, height=90 + 210 * rows, subplot_titles=titles, **spacing)
    for n, curve in enumerate(curves):
        for trace in _curve_traces(curve):
            figure.add_trace(trace, row=n // COLUMNS + 1, col=n % COLUMNS + 1)
    figure.update_yaxes(range=[-0.03, 1.03], tickformat=".0%")
    figure.update_layout(showlegend=False)
    caption = (
        "Share of the trials that succeed, over the size of each disturbance while all others vary too; the band is "
        "the 95 % interval of each point. Those that most surely change the success come first. Sideways pushes and "
        "slopes are taken by their size."
    )
    return [Figure(figure, caption)]


def _curve_traces(curve: SurvivalCurve) -> list[go.Scatter]:
    edges, trials = np.array(curve.edges), np.array(curve.trials)
    seen = trials > 0
    x = ((edges[1:] + edges[:-1]) / 2)[seen]
    rate = (np.array(curve.successes)[seen] / trials[seen]).astype(np.float32)
    low, high = np.array(curve.ci95)[seen].T.astype(np.float32)
    band = go.Scatter(
        x=np.concatenate([x, x[::-1]]),
        y=np.concatenate([high, low[::-1]]),
        fill="toself",
        fillcolor=faded(BLUE, 0.18),
        line_width=0,
        mode="lines",
        hoverinfo="skip",
    )
    text = [f"{n} trials" for n in trials[seen]]
    style = {"mode": "lines+markers", "line": {"color": BLUE, "width": 2}, "marker": {"size": 5}}
    dots = go.Scatter(x=x, y=rate, text=text, hovertemplate="%{x:.3~g}: %{y:.1%}, %{text}<extra></extra>", **style)
    return [band, dots]


def _sensitivity(file: RobustnessFile, sample: Trials) -> list[Block]:
    if not file.sensitivity:
        return [Text("Too few trials for a ranking, or nothing varied.")]
    shown = file.sensitivity[::-1]
    figure = new_figure(height=100 + 24 * len(shown))
    figure.add_bar(
        x=[s.share for s in shown],
        y=[s.name for s in shown],
        orientation="h",
        marker={"color": [_colour(s) for s in shown]},
        customdata=[[s.direction, s.p_value] for s in shown],
        hovertemplate="%{x:.1%} of the cost's rank variance; rank correlation %{customdata[0]:+.2f}, p = "
        "%{customdata[1]:.1e}<extra></extra>",
    )
    figure.update_layout(hovermode="closest", bargap=0.35, margin={"t": 16})
    figure.update_xaxes(title="share of the variance of the cost's rank", tickformat=".0%", rangemode="tozero")
    explained = sum(s.share for s in file.sensitivity)
    caption = (
        "What each perturbation explains alone of how the trials rank by cost (Kruskal and Wallis over ten bins). "
        "Orange: more of it is worse; green: more is better; blue: neither, off to both sides; grey: not told from "
        f"chance. Together {percent(explained)}; the rest are interactions, and what sensor noise does."
    )
    return [
        Figure(figure, caption),
        Figure(_cloud(file, sample), "Each trial's cost over the strongest perturbations."),
    ]


def _colour(sensitivity: Sensitivity) -> str:
    if sensitivity.p_value > SURELY:
        return GREY
    if abs(sensitivity.direction) < ONE_SIDED:
        return BLUE
    return ORANGE if sensitivity.direction > 0 else GREEN


def _cloud(file: RobustnessFile, sample: Trials) -> go.Figure:
    strongest = file.sensitivity[:COLUMNS]
    figure = new_figure(1, COLUMNS, height=300, shared_yaxes=True)
    cost, fine = sample["cost"][:CLOUD], sample["success"][:CLOUD] > 0.5
    for n, item in enumerate(strongest):
        x = sample[DRAWN + item.name][:CLOUD]
        for here, name, colour in ((fine, "succeeds", BLUE), (~fine, "fails", RED)):
            dots = {"mode": "markers", "marker": {"size": 4, "color": faded(colour, 0.55)}}
            trace = go.Scatter(x=x[here], y=cost[here], name=name, legendgroup=name, showlegend=n == 0, **dots)
            figure.add_trace(trace, row=1, col=n + 1)
        figure.update_xaxes(title=f"{item.name} [{item.unit}]", row=1, col=n + 1)
    figure.update_yaxes(title="cost", row=1, col=1)
    figure.update_layout(hovermode="closest")
    return figure


def _margins(file: RobustnessFile) -> list[Block]:
    names = list(file.margins)[::-1]
    figure = new_figure(height=110 + 34 * len(names))
    spreads = [file.margins[name] for name in names]
    labels = [_margin_name(name) for name in names]
    for spread, label in zip(spreads, labels, strict=True):
        whisker = {"mode": "lines", "hoverinfo": "skip", "showlegend": False}
        figure.add_scatter(x=[spread.low, spread.high], y=[label] * 2, line={"color": GREY, "width": 2}, **whisker)
        figure.add_scatter(x=[spread.p05, spread.p95], y=[label] * 2, line={"color": BLUE, "width": 9}, **whisker)
    marks = {"mode": "markers", "marker": {"color": ORANGE, "size": 9, "symbol": "line-ns", "line_width": 3}}
    figure.add_scatter(x=[s.p50 for s in spreads], y=labels, showlegend=False, **marks)
    figure.add_vrect(x0=min(0.0, *(s.low for s in spreads)) - 0.02, x1=0, fillcolor=FORBIDDEN, line_width=0)
    figure.update_layout(hovermode="closest", margin={"t": 16})
    figure.update_xaxes(title="left at the tightest moment of a trial")
    caption = (
        "How much of each limit is left at the tightest moment of the trials that succeed: the median, 5 to 95 %, and "
        "the whole range. Shares of the nominal limit, for joint stops radians. At 0 the limit is reached; below, the "
        "feet's impacts drive springs, motors or joints beyond what was commanded."
    )
    return [Figure(figure, caption), _spreads(file)]


def _margin_name(name: str) -> str:
    return name.removeprefix("margin_").replace("_", " ")


def _unit(unit: str) -> str:
    return "" if unit in ("1", "bool", "-") else unit


def _spreads(file: RobustnessFile) -> Table:
    rows = [
        [name, _unit(s.unit), *(number(x) for x in (s.mean, s.std, s.low, s.p05, s.p50, s.p95, s.high))]
        for name, s in (file.metrics | file.margins).items()
    ]
    header = ["Figure", "Unit", "Mean", "Std", "Least", "5 %", "Median", "95 %", "Most"]
    return Table(header, rows, f"Everything measured, over {file.sampled} trials.", numeric=range(2, 9))


def _worst(file: RobustnessFile) -> list[Block]:
    ranked = [s.name for s in file.sensitivity[:4]]
    rows = [
        [str(w.trial), "yes" if w.success else "no", number(w.cost), *(number(w.drawn[name]) for name in ranked)]
        for w in file.worst
    ]
    caption = f"The worst of {file.trials} trials, failures first, with what the strongest perturbations were in them."
    table = Table(["Trial", "Succeeds", "Cost", *ranked], rows, caption, numeric=(0, *range(2, 3 + len(ranked))))
    commands = "\n".join(w.command for w in file.worst[:3])
    return [table, Text("Each of them can be run again alone, and looked at with --output:"), Code(commands)]


def _provenance(file: RobustnessFile) -> list[Block]:
    facts = [
        ("Model that was perturbed", file.model_hash),
        ("Model that the motion was tuned on", file.tuned_on),
        ("Checksum of the parameters", file.parameters),
        ("Created (UTC)", file.created),
        *file.versions.items(),
    ]
    laws = [[name, law] for name, law in file.perturbations.items()]
    return [
        Code(file.command),
        Table(["", "This analysis"], facts, "What decides the result."),
        Table(["Perturbation", "Law"], laws, "What was drawn in each trial."),
    ]
