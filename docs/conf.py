"""Configuration of the documentation site: `make docs` builds it into site/; a broken link or an unknown reference fails the build."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

import insemu

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))
from architecture_drawing import write_drawing
from gallery_pages import write_gallery
from pictures import write_pictures
from reference_pages import write_reference

from tests.claims import claims, notes

project = "insemu"
author = copyright = "The insemu founders"
version = release = insemu.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "sphinx_copybutton"]
exclude_patterns = ["*.py", "gallery/*.py", "notebooks/*"]
suppress_warnings = ["misc.highlighting_failure"]  # YAML fragments and terminal output are shown as they are
myst_enable_extensions = ["attrs_inline"]
myst_heading_anchors = 3
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
autodoc_typehints = "none"  # the Parameters sections say shapes and units
copybutton_prompt_text = "$ "
html_theme = "furo"
html_title = "insemu"
html_copy_source = False
html_show_sourcelink = False


def check_offline(app: Sphinx, error: Exception | None) -> None:
    """Fail the build where a page loads something from another host: the site is read offline."""
    loads = re.compile(
        r'<(?:script|img|iframe)[^>]+src="https?://|<link[^>]+rel="(?:stylesheet|preload)"[^>]+href="https?://'
    )
    odd = [page.name for page in Path(app.outdir).rglob("*.html") if loads.search(page.read_text(encoding="utf-8"))]
    if error is None and odd:
        raise ExtensionError(f"pages that load from another host: {', '.join(odd)}")


COVERED, _ = claims()


def add_evidence(app: Sphinx, name: str, source: list[str]) -> None:
    """Say at the end of every section what its figures rest on, from ``docs/claims.yaml``."""
    held = notes(f"{name}.md", COVERED)
    up = "../" * name.count("/")
    for head, text in held.items():
        begin = re.search(rf"^#+ {re.escape(head)} *$", source[0], re.M)
        if begin is not None:
            rest = source[0][begin.end() :]
            code = [m.span() for m in re.finditer(r"^```.*?^```", rest, re.M | re.S)]
            ends = (m.start() for m in re.finditer(r"^#+ ", rest, re.M))
            end = next((e for e in ends if not any(a <= e < b for a, b in code)), len(rest))
            note = f"\n\n*[Evidence]({up}reference/evidence.md): {text}.*\n\n"
            source[0] = source[0][: begin.end()] + rest[:end].rstrip() + note + rest[end:]


def setup(app: Sphinx) -> None:
    """Sphinx calls this."""
    app.connect("source-read", add_evidence)
    app.connect("build-finished", check_offline)


write_reference(Path(__file__).parent / "reference")
write_pictures(Path(__file__).parent / "reference" / "pictures")
write_gallery(Path(__file__).parent / "reference")
write_drawing(Path(__file__).parent / "reference" / "pictures")
