"""One self-contained HTML page: sections of text, tables and figures; all text is escaped, nothing is loaded from elsewhere."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from insemu.report.charts import Chart, script, script_hash, stylesheet

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


Block = Text | Items | Table | Figure | Code | Chart | Folded


@dataclass(frozen=True)
class Section:
    """A headed part of the page."""

    title: str
    blocks: Sequence[Block]


_STYLE = """
:root { color-scheme: light dark; --ink: #1c2430; --soft: #5b6675; --line: #d9dee5; --wash: #f5f7f9; --paper: #ffffff; --accent: #0b5c8a;
  --shade: #e3e7ec; --good: #0a6b45; --warn: #8a4b00; --bad: #a8182b; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6eaf0; --soft: #a9b3c0; --line: #3a434f; --wash: #1f2630; --paper: #151a21; --accent: #7cc4ee;
  --shade: #2b333e; --good: #63d3a3; --warn: #f0b35f; --bad: #ff9aa6; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.55 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 76rem; margin: 0 auto; padding: 2rem 1.25rem 4rem; }
h1 { font-size: 1.5rem; line-height: 1.25; margin: 0 0 .4rem; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .6rem; padding-top: .9rem; border-top: 1px solid var(--line); }
p { max-width: 46rem; margin: .5rem 0; overflow-wrap: anywhere; }
.answer { font-size: 1.25rem; line-height: 1.4; font-weight: 600; max-width: 60rem; }
.lead { color: var(--soft); }
ul { max-width: 46rem; padding-left: 1.2rem; overflow-wrap: anywhere; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(15rem, 100%), 1fr)); gap: .8rem; margin: 1rem 0; }
.card { border: 1px solid var(--line); border-left: .35rem solid var(--soft); border-radius: 6px; background: var(--wash); padding: .7rem .9rem; }
.card h3 { font-size: 1rem; margin: 0; overflow-wrap: anywhere; }
.card .value { font-size: 1.35rem; font-weight: 650; font-variant-numeric: tabular-nums; }
.card .verdict { font-weight: 600; }
.card p { margin: .15rem 0; font-size: .9rem; }
.good { border-left-color: var(--good); } .good .verdict { color: var(--good); }
.warn { border-left-color: var(--warn); } .warn .verdict { color: var(--warn); }
.bad { border-left-color: var(--bad); } .bad .verdict { color: var(--bad); }
.scroll { overflow-x: auto; margin: .8rem 0 1.2rem; max-width: 100%; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; }
th, td { padding: .28rem .55rem; text-align: right; white-space: nowrap; border-bottom: 1px solid var(--line); }
.scroll thead th { white-space: normal; vertical-align: bottom; }
.scroll th { background: var(--wash); border-bottom: 2px solid var(--line); font-weight: 600; }
.scroll tbody th { border-bottom: 1px solid var(--line); }
.left { text-align: left; }
.scroll td:first-child.left, .scroll th:first-child.left { position: sticky; left: 0; background: var(--paper); }
tr.strong td { font-weight: 650; }
figure { margin: .8rem 0 1.4rem; }
.picture { overflow-x: auto; } img { width: 100%; max-width: 68rem; min-width: 36rem; height: auto; display: block; background: #ffffff; }
figcaption { color: var(--soft); font-size: .9rem; max-width: 50rem; margin-top: .35rem; }
pre { background: var(--wash); border: 1px solid var(--line); border-radius: 4px; padding: .8rem 1rem; overflow-x: auto; font-size: .84rem; }
nav { margin: 1rem 0 0; font-size: .92rem; }
nav a { color: var(--accent); margin-right: 1.1rem; }
details { margin: .8rem 0; } summary { cursor: pointer; color: var(--accent); }
.bar { display: flex; flex-wrap: wrap; gap: .5rem; align-items: center; font-size: .85rem; margin-bottom: .3rem; }
.bar button, .bar select { font: inherit; color: var(--ink); background: var(--wash); border: 1px solid var(--line); border-radius: 4px;
  padding: .15rem .6rem; } .bar label { max-width: 100%; } .bar select { max-width: min(30rem, calc(100vw - 3rem)); }
.plot { width: 100%; overflow: hidden; } .plot:focus-visible, button:focus-visible, select:focus-visible, summary:focus-visible, a:focus-visible
  { outline: 2px solid var(--accent); outline-offset: 2px; }
.u-legend { font-size: .82rem; text-align: left; } .u-legend th, .u-legend td { border: 0; padding: .05rem .3rem; }
footer { margin-top: 3rem; color: var(--soft); font-size: .85rem; border-top: 1px solid var(--line); padding-top: .8rem; overflow-wrap: anywhere; }
@media print { @page { size: A4; margin: 12mm; } :root { color-scheme: light; --ink: #000; --soft: #333; --line: #bbb; --wash: #fff; --paper: #fff;
  --shade: #e3e7ec; } body { font-size: 9.5pt; } main { padding: 0; max-width: none; } nav, .bar, .no-print, details:not([open]) { display: none; }
  h2 { break-after: avoid; margin-top: 1.2rem; } figure, .card, tr { break-inside: avoid; } .scroll, .picture { overflow: visible; }
  img { max-height: 85mm; width: auto; min-width: 0; max-width: 100%; }
  table { font-size: 7.5pt; } th, td { white-space: normal; padding: .15rem .3rem; } }
"""

_TEMPLATE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src '{{ script_hash }}'">
<title>{{ title }}</title>
<style>{{ style }}{% if charts %}{{ stylesheet }}{% endif %}</style>
</head>
<body><main>
<h1>{{ title }}</h1>
{% if answer %}<p class="answer">{{ answer }}</p>{% endif %}
{% if lead %}<p class="lead">{{ lead }}</p>{% endif %}
{% if cards %}<div class="cards">{% for c in cards %}
<div class="card {{ c.tone }}"><h3>{{ c.title }}</h3><p class="value">{{ c.value }}</p><p class="verdict">{{ c.verdict }}</p>
{% for n in c.notes %}<p>{{ n }}</p>{% endfor %}</div>
{% endfor %}</div>{% endif %}
{% if sections|length > 2 %}<nav aria-label="Sections">
{% for s in sections %}<a href="#s{{ loop.index }}">{{ s.title }}</a> {% endfor %}</nav>{% endif %}
{% macro show(b) %}{% set kind = b.__class__.__name__ %}
{% if kind == "Text" %}<p>{{ b.text }}</p>
{% elif kind == "Items" %}<ul>{% for i in b.items %}<li>{{ i }}</li>{% endfor %}</ul>
{% elif kind == "Table" %}{% if b.caption %}<p class="lead">{{ b.caption }}</p>{% endif %}<div class="scroll" tabindex="0"><table>
<thead><tr>{% for h in b.header %}<th{% if loop.index0 < b.left %} class="left"{% endif %} scope="col">{{ h }}</th>{% endfor %}</tr></thead>
<tbody>{% for r in b.rows %}<tr{% if loop.index0 in b.strong %} class="strong"{% endif %}>
{%- for c in r %}<td{% if loop.index0 < b.left %} class="left"{% endif %}>{{ c }}</td>{% endfor %}</tr>
{% endfor %}</tbody></table></div>
{% elif kind == "Figure" %}<figure><div class="picture" tabindex="0"><img alt="{{ b.caption }}" src="data:image/png;base64,{{ base64(b.png) }}"></div>
<figcaption>{{ b.caption }}</figcaption></figure>
{% elif kind == "Chart" %}<figure class="chart"><div class="bar no-print"></div><div class="plot"></div>
<script type="application/json">{{ safe(b.to_json()) }}</script>
{% if b.png %}<noscript><img alt="{{ b.caption }}" src="data:image/png;base64,{{ base64(b.png) }}"></noscript>{% endif %}
<figcaption>{{ b.caption }}</figcaption></figure>
{% elif kind == "Code" %}{% if b.caption %}<p>{{ b.caption }}</p>{% endif %}<pre tabindex="0">{{ b.text }}</pre>
{% elif kind == "Folded" %}<details><summary>{{ b.summary }}</summary>{% for inner in b.blocks %}{{ show(inner) }}{% endfor %}</details>
{% endif %}{% endmacro %}
{% for s in sections %}
<section><h2 id="s{{ loop.index }}">{{ s.title }}</h2>
{% for b in s.blocks %}{{ show(b) }}{% endfor %}</section>
{% endfor %}
<footer>{{ footer }}</footer>
</main>{% if charts %}<script>{{ script }}</script>{% endif %}</body></html>
"""


def _has_chart(blocks: Iterable[Block]) -> bool:
    return any(isinstance(b, Chart) or (isinstance(b, Folded) and _has_chart(b.blocks)) for b in blocks)


def render(
    title: str,
    sections: Sequence[Section],
    path: str | Path,
    *,
    answer: str = "",
    lead: str = "",
    cards: Sequence[Card] = (),
    footer: str = "",
) -> Path:
    """Write the page.

    Parameters
    ----------
    title, answer, lead, footer : str
        Plain text; escaped like all other text. ``answer`` is the one sentence that the reader came for.
    sections : sequence of Section
    path : path
        File to write; its folder is made.
    cards : sequence of Card
        Verdicts, below the answer.

    Returns
    -------
    Path
        The file.
    """
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    template = environment.from_string(_TEMPLATE)
    charts = any(_has_chart(s.blocks) for s in sections)
    html = template.render(
        title=title,
        answer=answer,
        lead=lead,
        cards=cards,
        footer=footer,
        sections=sections,
        charts=charts,
        style=Markup(_STYLE),
        stylesheet=Markup(stylesheet()) if charts else "",
        script=Markup(script()) if charts else "",
        script_hash=script_hash() if charts else "none",
        safe=Markup,  # JSON of a chart escapes what could close a tag
        base64=lambda data: base64.b64encode(data).decode("ascii"),
    )
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(html, encoding="utf-8")
    return path
