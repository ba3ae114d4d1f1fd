"""One self-contained HTML page: sections of text, tables and figures; all text is escaped, nothing is loaded from elsewhere."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from jinja2 import Environment, StrictUndefined

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure


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
    """A table; the first ``left`` columns are aligned left, the others right. ``strong`` rows are emphasised."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    left: int = 1
    strong: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Figure:
    """A picture (PNG bytes) with its caption, which also serves readers who cannot see it."""

    png: bytes
    caption: str

    @classmethod
    def of(cls, figure: MplFigure, caption: str, dpi: int = 130) -> Figure:
        """Render a matplotlib figure and close it."""
        import matplotlib.pyplot as plt

        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=dpi)
        plt.close(figure)
        return cls(buffer.getvalue(), caption)


@dataclass(frozen=True)
class Code:
    """Text in a fixed-width face, as it stands (YAML, commands)."""

    text: str
    caption: str = ""


Block = Text | Items | Table | Figure | Code


@dataclass(frozen=True)
class Section:
    """A headed part of the page."""

    title: str
    blocks: Sequence[Block]


_TEMPLATE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{{ title }}</title>
<style>
:root { --ink: #1c2430; --soft: #5b6675; --line: #d9dee5; --wash: #f5f7f9; --accent: #0b5c8a; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); font: 16px/1.55 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 76rem; margin: 0 auto; padding: 2rem 1.25rem 4rem; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 .4rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .6rem; padding-top: .9rem; border-top: 1px solid var(--line); }
p { max-width: 46rem; margin: .5rem 0; }
.lead { color: var(--soft); }
ul { max-width: 46rem; padding-left: 1.2rem; }
.scroll { overflow-x: auto; margin: .8rem 0 1.2rem; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; color: var(--soft); padding-bottom: .4rem; }
th, td { padding: .28rem .55rem; text-align: right; white-space: nowrap; border-bottom: 1px solid var(--line); }
th { background: var(--wash); border-bottom: 2px solid var(--line); font-weight: 600; }
.left { text-align: left; }
tr.strong td { font-weight: 650; }
figure { margin: .8rem 0 1.4rem; }
img { max-width: 100%; height: auto; display: block; }
figcaption { color: var(--soft); font-size: .9rem; max-width: 50rem; margin-top: .35rem; }
pre { background: var(--wash); border: 1px solid var(--line); border-radius: 4px; padding: .8rem 1rem; overflow-x: auto; font-size: .84rem; }
nav { margin: 1rem 0 0; font-size: .92rem; }
nav a { color: var(--accent); margin-right: 1.1rem; white-space: nowrap; }
footer { margin-top: 3rem; color: var(--soft); font-size: .85rem; border-top: 1px solid var(--line); padding-top: .8rem; }
</style>
</head>
<body><main>
<h1>{{ title }}</h1>
{% if lead %}<p class="lead">{{ lead }}</p>{% endif %}
{% if sections|length > 2 %}<nav>{% for s in sections %}<a href="#s{{ loop.index }}">{{ s.title }}</a>{% endfor %}</nav>{% endif %}
{% for s in sections %}
<section><h2 id="s{{ loop.index }}">{{ s.title }}</h2>
{% for b in s.blocks %}{% set kind = b.__class__.__name__ %}
{% if kind == "Text" %}<p>{{ b.text }}</p>
{% elif kind == "Items" %}<ul>{% for i in b.items %}<li>{{ i }}</li>{% endfor %}</ul>
{% elif kind == "Table" %}<div class="scroll"><table>{% if b.caption %}<caption>{{ b.caption }}</caption>{% endif %}
<thead><tr>{% for h in b.header %}<th{% if loop.index0 < b.left %} class="left"{% endif %} scope="col">{{ h }}</th>{% endfor %}</tr></thead>
<tbody>{% for r in b.rows %}<tr{% if loop.index0 in b.strong %} class="strong"{% endif %}>
{%- for c in r %}<td{% if loop.index0 < b.left %} class="left"{% endif %}>{{ c }}</td>{% endfor %}</tr>
{% endfor %}</tbody></table></div>
{% elif kind == "Figure" %}<figure><img alt="{{ b.caption }}" src="data:image/png;base64,{{ base64(b.png) }}">
<figcaption>{{ b.caption }}</figcaption></figure>
{% elif kind == "Code" %}{% if b.caption %}<p>{{ b.caption }}</p>{% endif %}<pre>{{ b.text }}</pre>
{% endif %}{% endfor %}</section>
{% endfor %}
<footer>{{ footer }}</footer>
</main></body></html>
"""


def render(title: str, sections: Sequence[Section], path: str | Path, *, lead: str = "", footer: str = "") -> Path:
    """Write the page.

    Parameters
    ----------
    title, lead, footer : str
        Plain text; escaped like all other text.
    sections : sequence of Section
    path : path
        File to write; its folder is made.

    Returns
    -------
    Path
        The file.
    """
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    template = environment.from_string(_TEMPLATE)
    html = template.render(
        title=title,
        lead=lead,
        footer=footer,
        sections=sections,
        base64=lambda data: base64.b64encode(data).decode("ascii"),
    )
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(html, encoding="utf-8")
    return path
