"""The report of `starleth diagnose`: the verdict in plain words, the error ladder, maps, ranking, signals."""

from pathlib import Path

from experiments.measurement.diagnose import Diagnosis
from experiments.measurement.selection.linear_score import best_of_each
from experiments.measurement.selection.verdict import refitted_rms
from experiments.reports.diagnosis_figures import ladder, maps, signals, spectra
from experiments.reports.numbers import number
from experiments.reports.page import Block, Card, Cards, Section, Table, Text, write_report

RANKED = 12


def write_diagnosis_report(path: Path, found: Diagnosis) -> None:
    """One HTML file that needs no network. Raises UserError."""
    result: list[Block] = [Cards(_cards(found)), Text(found.text, "lead")]
    if found.next_experiment.text:
        result.append(Text(f"What would tell more: {found.next_experiment.text}."))
    sections = [
        Section("Result", [*result, *_parameters(found)]),
        Section("The error ladder", [ladder(found)]),
        Section("Where the model fails", maps(found)),
        Section("Which effect", [_ranking(found)]),
        Section("Measured against model", signals(found)),
        Section("What is left", [*_rest(found), *spectra(found)]),
    ]
    write_report(path, "Diagnosis", ", ".join(log.name for log in found.logs), sections)


def _cards(found: Diagnosis) -> list[Card]:
    tone = "good" if found.verdict in ("none", "explained") else "bad"
    cards = [Card("Verdict", found.verdict.replace("_", " "), tone=tone)]
    for entry in found.answer["effects"]:
        before, after = entry["held_out_error_before"], entry["held_out_error_after"]
        note = f"worst channel on held-out parts, {before:.2f} × noise without it"
        cards.append(Card(f"{entry['effect']} at {entry['where']}", f"{after:.2f}", "× noise", note))
    if found.answer["effects"]:
        cards.append(Card("Left unexplained", f"{100 * found.answer['unexplained_fraction']:.1f}", "%"))
    return cards


def _parameters(found: Diagnosis) -> list[Block]:
    rows = []
    for entry in found.answer["effects"]:
        for name, p in entry["parameters"].items():
            low, high = p["ci95"]
            interval = f"{number(low, 5)} to {number(high, 5)}"
            rows.append((entry["effect"], entry["where"], name, number(p["value"], 5), interval, p["unit"]))
    header = ("effect", "place", "parameter", "value", "95 % interval", "unit")
    blocks: list[Block] = []
    if rows:
        blocks.append(Table(header, rows, "What to put into the model: `starleth learn` does.", numeric=(3, 4)))
    unseen = [
        (f"{entry['effect']} at {entry['where']}", u["log"], f"{u['error_before']:.2f}", f"{u['error_after']:.2f}")
        for entry in found.answer["effects"]
        for u in entry["other_experiments"]
    ]
    if unseen:
        caption = "Fitted to the other logs alone: worst channel over noise of a log left out whole."
        blocks.append(Table(("effect", "unseen log", "without it", "with it"), unseen, caption, numeric=(2, 3)))
    return blocks


def _rest(found: Diagnosis) -> list[Block]:
    """What the rest of the worst channels goes with."""
    rows = [(h.log, h.channel, f"{h.over_noise:.2f}", h.input, h.way, f"{h.correlation:+.2f}") for h in found.rest]
    header = ("log", "channel", "over noise", "input or state", "the rest", "correlation")
    caption = (
        "What the unexplained rest goes with: it follows the input in sign, or its size grows with the input's size."
    )
    return [Table(header, rows, caption, numeric=(2, 5))] if rows else []


def _ranking(found: Diagnosis) -> Block:
    if not found.selection.rankings:
        return Text("Nothing was scored: the model explains the log.")
    best = [s for s in best_of_each(found.selection.rankings[0]) if s.gain > 0][:RANKED]
    refitted = refitted_rms(found.selection, found.logs)
    rows = []
    for s in best:
        suggested = ", ".join(f"{name} {number(value)}" for name, value in s.values.items())
        left = refitted.get((s.effect.name, s.where))
        left = "" if left is None else f"{left:.2f}"
        rows.append((s.effect.name, s.where, f"{s.gain:.0f}", left, suggested, s.effect.about))
    header = ("effect", "best place", "score", "refitted: × noise", "suggested numbers", "meaning")
    caption = (
        "First look: fall of chi-square that each effect alone promises, linearly; of the best, what a refit in the "
        "full simulation leaves on held-out parts, RMS over noise. The latter decides."
    )
    return Table(header, rows, caption, numeric=(2, 3))
