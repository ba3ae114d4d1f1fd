"""The gallery: every example is run, its picture and what it prints stand beside its code."""

from __future__ import annotations

import io
import runpy
from contextlib import redirect_stdout
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

EXAMPLES = sorted((Path(__file__).parent / "gallery").glob("*.py"))


def run(example: Path, picture: Path) -> str:
    """Run an example, save its figure, return what it printed."""
    plt.close("all")
    said = io.StringIO()
    with redirect_stdout(said):
        runpy.run_path(str(example), run_name=f"gallery_{example.stem}")
    figure = plt.gcf()
    figure.set_size_inches(7.0, 3.6)
    figure.savefig(picture, dpi=70, bbox_inches="tight")
    plt.close("all")
    return said.getvalue()


def write_gallery(folder: Path) -> None:
    """Write ``gallery.md`` and the pictures; an example that is older than its picture is not run again."""
    pictures = folder / "gallery"
    pictures.mkdir(parents=True, exist_ok=True)
    lines = ["# Gallery", "", "Every example is run when this site is built, and by the tests.", ""]
    for example in EXAMPLES:
        code = example.read_text(encoding="utf-8")
        head, _, body = code.partition('"""\n')
        title = head.strip('"').strip()
        picture, said = pictures / f"{example.stem}.png", pictures / f"{example.stem}.txt"
        if not said.exists() or said.stat().st_mtime < example.stat().st_mtime:
            said.write_text(run(example, picture), encoding="utf-8")
        printed = said.read_text(encoding="utf-8").strip()
        name = example.stem.replace("_", " ")
        lines += [f"## {name[:1].upper()}{name[1:]}", "", title, "", f"![{title}](gallery/{example.stem}.png)", ""]
        lines += ["```python", body.strip(), "```", "", *(["```text", printed, "```", ""] if printed else [])]
    (folder / "gallery.md").write_text("\n".join(lines), encoding="utf-8")
