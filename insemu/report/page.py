"""One self-contained HTML page: sections of text, tables and figures, everything escaped, figures inside the file.

    page = Page("Static log", subtitle="run 1")
    page.add(Section("What was found", text="Two axes warm up.", bullets=findings, table=table, figures=[figure]))
    page.write(path)

A figure is a matplotlib figure (drawn as PNG), or bytes of a PNG or SVG.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jinja2


@dataclass(frozen=True)
class Table:
    """A table of text and numbers.

    Parameters
    ----------
    columns : sequence of str
        Header cells.
    rows : sequence of sequences
        Cells; numbers are printed with ``digits`` significant digits and right-aligned, None as a dash.
    caption : str
        Said above it.
    digits : int
        Significant digits.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    digits: int = 4

    def cells(self) -> list[list[tuple[str, bool]]]:
        """Return rows of ``(text, is a number)``."""
        return [[_cell(value, self.digits) for value in row] for row in self.rows]


def _cell(value: Any, digits: int) -> tuple[str, bool]:
    if value is None:
        return "–", False
    if isinstance(value, bool | str):
        return {True: "yes", False: "no"}.get(value, str(value)) if isinstance(value, bool) else value, False
    try:
        return f"{value:.{digits}g}", True
    except (TypeError, ValueError):
        return str(value), False


@dataclass(frozen=True)
class Figure:
    """A figure with its caption.

    Parameters
    ----------
    image : bytes
        PNG or SVG.
    caption : str
        Shown below it; also its text for those who do not see it.
    wide : bool
        Full width of the page; two narrow figures stand side by side.
    """

    image: bytes
    caption: str = ""
    wide: bool = True

    @classmethod
    def of(cls, drawing: Any, caption: str = "", *, wide: bool = True, dpi: int = 110) -> Figure:
        """Draw a matplotlib figure as PNG (and close nothing: the caller owns it)."""
        buffer = io.BytesIO()
        drawing.savefig(buffer, format="png", dpi=dpi)
        return cls(buffer.getvalue(), caption, wide)

    @property
    def uri(self) -> str:
        """The image as a data address."""
        kind = "png" if self.image.startswith(b"\x89PNG") else "svg+xml"
        return f"data:image/{kind};base64,{base64.b64encode(self.image).decode('ascii')}"


@dataclass(frozen=True)
class Section:
    """A part of the page; whatever is given appears in the order text, bullets, table, figures.

    Parameters
    ----------
    title : str
        Heading.
    text : str
        Paragraphs, separated by empty lines.
    bullets : sequence of str
        A list.
    table : Table, optional
        One table.
    figures : sequence of Figure
        Figures.
    alert : bool
        The section says that something is wrong; it is marked.
    """

    title: str
    text: str = ""
    bullets: Sequence[str] = ()
    table: Table | None = None
    figures: Sequence[Figure] = ()
    alert: bool = False

    @property
    def paragraphs(self) -> list[str]:
        """The text's paragraphs."""
        return [p.strip() for p in self.text.split("\n\n") if p.strip()]


_TEMPLATE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>
body { margin: 0; background: #fff; color: #1c2126; font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 68rem; margin: 0 auto; padding: 2rem 1.25rem 4rem; }
header { border-bottom: 2px solid #1c2126; margin-bottom: 1.5rem; padding-bottom: .6rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0; }
header p { margin: .3rem 0 0; color: #55606a; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; }
section.alert { border-left: 4px solid #b3401f; padding-left: 1rem; }
section.alert h2 { margin-top: 1rem; }
p, li { max-width: 46rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; margin: .6rem 0; }
caption { text-align: left; color: #55606a; padding-bottom: .3rem; }
th, td { padding: .28rem .8rem .28rem 0; text-align: left; border-bottom: 1px solid #e3e7ea; white-space: nowrap; }
th { border-bottom: 1px solid #1c2126; font-weight: 600; }
td.n { text-align: right; }
.figures { display: flex; flex-wrap: wrap; gap: 1rem; }
figure { margin: .6rem 0; flex: 1 1 24rem; min-width: 0; }
figure.wide { flex-basis: 100%; }
figure img { max-width: 100%; height: auto; }
figcaption, footer, nav { color: #55606a; font-size: .88rem; }
nav a { margin-right: 1rem; color: #1f5fa8; }
footer { margin-top: 3rem; border-top: 1px solid #e3e7ea; padding-top: .8rem; }
footer td, footer th { border: 0; padding: .1rem .8rem .1rem 0; white-space: normal; }
</style>
</head>
<body><main>
<header><h1>{{ title }}</h1>{% if subtitle %}<p>{{ subtitle }}</p>{% endif %}</header>
{% if sections | length > 3 %}<nav>{% for s in sections %}<a href="#s{{ loop.index }}">{{ s.title }}</a>{% endfor %}</nav>{% endif %}
{% for s in sections %}
<section id="s{{ loop.index }}"{% if s.alert %} class="alert"{% endif %}>
<h2>{{ s.title }}</h2>
{% for p in s.paragraphs %}<p>{{ p }}</p>
{% endfor %}
{% if s.bullets %}<ul>{% for b in s.bullets %}<li>{{ b }}</li>
{% endfor %}</ul>{% endif %}
{% if s.table %}<div class="scroll"><table>
{% if s.table.caption %}<caption>{{ s.table.caption }}</caption>{% endif %}
<thead><tr>{% for c in s.table.columns %}<th>{{ c }}</th>{% endfor %}</tr></thead>
<tbody>{% for row in s.table.cells() %}
<tr>{% for text, number in row %}<td{% if number %} class="n"{% endif %}>{{ text }}</td>{% endfor %}</tr>{% endfor %}
</tbody></table></div>{% endif %}
{% if s.figures %}<div class="figures">{% for f in s.figures %}
<figure{% if f.wide %} class="wide"{% endif %}><img src="{{ f.uri }}" alt="{{ f.caption }}">
{% if f.caption %}<figcaption>{{ f.caption }}</figcaption>{% endif %}</figure>{% endfor %}</div>{% endif %}
</section>
{% endfor %}
{% if facts %}<footer><table>{% for key, value in facts.items() %}
<tr><th>{{ key }}</th><td>{{ value }}</td></tr>{% endfor %}</table></footer>{% endif %}
</main></body></html>
"""

_ENVIRONMENT = jinja2.Environment(
    autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
)


@dataclass
class Page:
    """A page under construction.

    Parameters
    ----------
    title, subtitle : str
        Heading.
    facts : mapping
        How it was made (input, seed, versions); printed small at the end.
    """

    title: str
    subtitle: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)
    sections: list[Section] = field(default_factory=list)

    def add(self, section: Section) -> None:
        """Append a section."""
        self.sections.append(section)

    def html(self) -> str:
        """Return the page; every text in it is escaped."""
        template = _ENVIRONMENT.from_string(_TEMPLATE)
        return template.render(title=self.title, subtitle=self.subtitle, sections=self.sections, facts=dict(self.facts))

    def write(self, path: str | Path) -> Path:
        """Write the page and return where."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(self.html(), encoding="utf-8")
        return path
