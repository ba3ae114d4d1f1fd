"""One self-contained HTML page: sections of text, tables and figures; all text is escaped, nothing is loaded from elsewhere."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from jinja2 import Environment, StrictUndefined, Template
from markupsafe import Markup

from insemu import __version__
from insemu.progress import say_once
from insemu.report.charts import Chart, Ledger, asset, embedded, script, script_hash
from insemu.report.style import NO_MATPLOTLIB, can_draw
from insemu.whole import put


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


@dataclass(frozen=True)
class Items:
    """A bulleted list."""

    items: Sequence[str]


@dataclass(frozen=True)
class Table:
    """A table; the first ``left`` columns are aligned left, the others right. ``strong`` rows are emphasised; cells ``wrap`` or not.

    ``heat`` tints cells of a heat map: a share from 0 to 1 for each, None without.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    left: int = 1
    strong: frozenset[int] = frozenset()
    wrap: bool = False
    heat: Sequence[Sequence[float | None]] = ()


@dataclass(frozen=True)
class Code:
    """Text in a fixed-width face, as it stands (YAML, commands)."""

    text: str
    caption: str = ""


@dataclass(frozen=True)
class Card:
    """The verdict on one thing, such as a design or an axis.

    Parameters
    ----------
    title : str
    value : str
        The figure that matters, with its unit.
    verdict : str
        One word or a short phrase.
    tone : str
        ``good``, ``warn``, ``bad`` or ``plain``; the verdict says the same in words.
    notes : sequence of str
        Lines below.
    """

    title: str
    value: str
    verdict: str
    tone: str = "plain"
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Folded:
    """Blocks that the reader opens."""

    summary: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Form:
    """Blocks with choices that a button sends to an address of the same server."""

    address: str
    button: str
    blocks: Sequence[Block]


Block = Form | Text | Items | Table | Ledger | Code | Chart | Folded


@dataclass(frozen=True)
class Section:
    """A headed part of the page."""

    title: str
    blocks: Sequence[Block]


def made_on() -> str:
    """The date, UTC; ``SOURCE_DATE_EPOCH`` stands for now where it is set."""
    given = os.environ.get("SOURCE_DATE_EPOCH", "")
    return time.strftime("%Y-%m-%d", time.gmtime(int(given) if given.isdigit() else None))


def charts_of(sections: Iterable[Section]) -> list[Chart]:
    """Every chart of a page."""

    def inside(blocks: Iterable[Block]) -> Iterator[Chart]:
        for b in blocks:
            if isinstance(b, Chart):
                yield b
            elif isinstance(b, Folded):
                yield from inside(b.blocks)

    return [chart for s in sections for chart in inside(s.blocks)]


@cache
def _template() -> Template:
    return Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True).from_string(asset("page.html"))


@dataclass(frozen=True)
class Page:
    """A page: what is on it, and what it says of itself. Texts are plain; they are escaped.

    Parameters
    ----------
    title : str
    sections : sequence of Section
    kind, source : str
        Command that makes the page, and the file that it was asked about.
    answer : str
        The one sentence that the reader came for.
    lead : str
        What stands below it.
    cards : sequence of Card
        Verdicts, below the answer.
    """

    title: str
    sections: Sequence[Section]
    kind: str
    source: str = ""
    answer: str = ""
    lead: str = ""
    cards: Sequence[Card] = ()

    @property
    def line(self) -> str:
        """File, date and version in one line."""
        return ", ".join(x for x in (self.source and Path(self.source).name, made_on(), f"insemu {__version__}") if x)

    @property
    def json(self) -> str:
        """As the list of pages reads it."""
        said = {key: getattr(self, key) for key in ("kind", "title", "answer", "source")}
        verdicts = [[c.title, c.value, c.verdict, c.tone] for c in self.cards]
        return embedded({"insemu": __version__, "made": made_on(), **said, "cards": verdicts})

    def html(self, *, forms: bool = False) -> str:
        """The page as HTML; ``forms``: whether it may send what a :class:`Form` holds to the server that it came from."""
        return _template().render(
            page=self,
            style=Markup(asset("page.css", "uPlot.min.css")),
            script=Markup(script()),
            script_hash=script_hash(),
            forms=Markup("'self'" if forms else "'none'"),
            safe=Markup,  # JSON of a chart escapes what could close a tag
        )

    def write(self, path: str | Path, *, pictures: bool = False) -> Path:
        """Write the page and return its file.

        Parameters
        ----------
        path : path
            File to write; its folder is made.
        pictures : bool
            Whether every chart is also written as PNG and SVG into the folder ``figures`` next to the page.
        """
        html, path = self.html(), Path(path)
        if pictures and (charts := charts_of(self.sections)):
            if can_draw():
                from insemu.report.static import save

                save(charts, path.parent / "figures")
            else:
                say_once(f"No charts as PNG and SVG next to the page: {NO_MATPLOTLIB}")
        put(path, html)
        return path
