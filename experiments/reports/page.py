"""One offline HTML file per report: numbered figures and tables, metric cards, text, all in one page.

A report is a list of sections, a section a list of blocks. A block knows how to render itself:

    write_report(path, "Squat jump", "StarlETH, full drive", [
        Section("The jump", [Text("…"), Figure(figure, caption="What to see."), Table(["name"], [["x"]], "…")]),
    ])

Nothing is fetched: scripts and data stand in the page, and its content security policy forbids the rest. Text is
escaped; pass `markupsafe.Markup` for HTML of your own.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal, Protocol

import plotly.graph_objects as go
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from experiments.files import write_text


class Block(Protocol):
    """A part of a section."""

    def render(self, page: "Page") -> Markup:
        """HTML of the block; takes its number from the page and asks it for the scripts it needs."""


@dataclass
class Page:
    """What blocks share while a report is rendered."""

    figures: int = 0
    tables: int = 0
    scripts: list[str] = field(default_factory=list)  # files of this folder, each once, in order of need
    plotly: bool = False

    def next_figure(self) -> int:
        self.figures += 1
        return self.figures

    def next_table(self) -> int:
        self.tables += 1
        return self.tables

    def need(self, script: str) -> None:
        """Include a script file of this folder in the page."""
        if script not in self.scripts:
            self.scripts.append(script)


@dataclass(frozen=True)
class Section:
    """A heading and its blocks."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    tone: Literal["plain", "lead", "warning"] = "plain"

    def render(self, page: Page) -> Markup:
        return Markup('<p class="text {}">{}</p>').format(self.tone, self.text)


@dataclass(frozen=True)
class Card:
    """A headline figure: what, how much, and how sure or compared with what."""

    label: str
    value: str
    unit: str = ""
    note: str = ""
    tone: Literal["plain", "good", "bad"] = "plain"


@dataclass(frozen=True)
class Cards:
    """Headline figures side by side."""

    cards: Sequence[Card]

    def render(self, page: Page) -> Markup:
        one = Markup(
            '<div class="card {}"><dt>{}</dt><dd><span class="value">{}</span> <span class="unit">{}</span></dd>'
            '<dd class="note">{}</dd></div>'
        )
        cards = [one.format(c.tone, c.label, c.value, c.unit, c.note) for c in self.cards]
        return Markup('<dl class="cards">{}</dl>').format(Markup("").join(cards))


@dataclass(frozen=True)
class Figure:
    """A Plotly figure; the caption says what to see. Clicking a figure over `time` moves the playback there."""

    figure: go.Figure
    caption: str
    time_axis: bool = False

    def render(self, page: Page) -> Markup:
        page.plotly = True
        number = page.next_figure()
        content = json.loads(self.figure.to_json())
        content["layout"].pop("template", None)  # the page brings its own, in light and dark
        return Markup(
            '<figure id="figure-{n}"><div class="plot" {time} style="height:{height}px">'
            '<script type="application/json">{data}</script></div>'
            "<figcaption><b>Figure {n}.</b> {caption}</figcaption></figure>"
        ).format(
            n=number,
            height=int(self.figure.layout.height or 360),
            time=Markup("data-time-axis") if self.time_axis else "",
            data=embedded_json(content),
            caption=self.caption,
        )


@dataclass(frozen=True)
class Range:
    """A table cell that shows where a value lies between its bounds."""

    value: float
    low: float
    high: float

    def __html__(self) -> Markup:
        width = self.high - self.low
        share = (self.value - self.low) / width if width > 0 else 0.5
        kind = "range" if 0.01 < share < 0.99 else "range at-bound"
        left = Markup(f"{100 * min(max(share, 0), 1):.1f}%")
        return Markup('<span class="{}"><i style="left:{}"></i></span>').format(kind, left)


@dataclass(frozen=True)
class Table:
    """A table; columns in `numeric` are set flush right. Cells are text or anything with `__html__`."""

    header: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    numeric: Sequence[int] = ()

    def render(self, page: Page) -> Markup:
        def row(tag: str, cells: Sequence[Any]) -> Markup:
            kinds = ["number" if i in self.numeric else "" for i in range(len(cells))]
            one = Markup("<{0} class='{1}'>{2}</{0}>")
            tag_ = Markup(tag)
            return Markup("<tr>{}</tr>").format(
                Markup("").join(one.format(tag_, kind, cell) for kind, cell in zip(kinds, cells, strict=True))
            )

        caption = Markup("")
        if self.caption:
            caption = Markup("<figcaption><b>Table {}.</b> {}</figcaption>").format(page.next_table(), self.caption)
        return Markup(
            '<figure class="table">{}<div class="scroll"><table><thead>{}</thead><tbody>{}</tbody></table></div>'
            "</figure>"
        ).format(caption, row("th", self.header), Markup("").join(row("td", r) for r in self.rows))


@dataclass(frozen=True)
class Code:
    """A command or a file's text, as it stands."""

    text: str

    def render(self, page: Page) -> Markup:
        return Markup("<pre><code>{}</code></pre>").format(self.text)


@dataclass(frozen=True)
class Columns:
    """Columns of blocks, side by side where the page is wide enough."""

    columns: Sequence[Sequence[Block]]

    def render(self, page: Page) -> Markup:
        def column(blocks: Sequence[Block]) -> Markup:
            return Markup("<div>{}</div>").format(Markup("").join(block.render(page) for block in blocks))

        return Markup('<div class="columns">{}</div>').format(Markup("").join(map(column, self.columns)))


def write_report(path: Path | str, title: str, subtitle: str, sections: Sequence[Section]) -> None:
    """Write the page atomically. Raises UserError (full disk, no permission)."""
    write_text(path, render_report(title, subtitle, sections))


def render_report(title: str, subtitle: str, sections: Sequence[Section]) -> str:
    """The page as text."""
    page = Page()
    bodies = [
        (f"section-{n}", section.title, [block.render(page) for block in section.blocks])
        for n, section in enumerate(sections, 1)
    ]
    scripts = [Markup(get_plotlyjs())] if page.plotly else []
    scripts += [Markup(resource(name)) for name in [*page.scripts, "page.js"]]
    return _template().render(
        title=title, subtitle=subtitle, sections=bodies, style=Markup(resource("page.css")), scripts=scripts
    )


def embedded_json(content: Any) -> Markup:
    """JSON that is safe inside a <script> element: no tag can end or begin in it."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))


def resource(name: str) -> str:
    """Text of a file of this folder."""
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


@cache
def _template() -> Any:
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(resource("page.html"))
