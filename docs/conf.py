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
from gallery_pages import write_gallery
from pictures import write_pictures
from reference_pages import write_reference

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


def setup(app: Sphinx) -> None:
    """Sphinx calls this."""
    app.connect("build-finished", check_offline)


write_reference(Path(__file__).parent / "reference")
write_pictures(Path(__file__).parent / "reference" / "pictures")
write_gallery(Path(__file__).parent / "reference")
