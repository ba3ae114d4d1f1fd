"""Weight of the pages of a run, time to the first paint (beside an empty page), pages on paper. Needs Chromium.

Usage: python benchmarks/pages.py [FOLDER]   (default: a run of scenarios/table3_synthetic.yaml with four realizations)
"""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
REPEATS = 5


def first_paint(browser: Any, page: Path) -> float:
    """Median time to the first contentful paint, ms."""
    times = []
    for _ in range(REPEATS):
        tab = browser.new_page(viewport={"width": 1280, "height": 900})
        tab.goto(page.as_uri())
        entry = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? null"
        while (paint := tab.evaluate(entry)) is None:  # wait_for_function is refused by the page's security policy
            tab.wait_for_timeout(20)
        times.append(paint)
        tab.close()
    return statistics.median(times)


def main() -> None:
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        print("no Chromium is installed")
        return
    with tempfile.TemporaryDirectory() as made:
        if len(sys.argv) > 1:
            folder = Path(sys.argv[1]).resolve()
        else:
            folder = Path(made) / "run"
            command = [sys.executable, "-m", "insemu", "run", "scenarios/table3_synthetic.yaml", "--realizations", "4"]
            subprocess.run([*command, "--output", str(folder)], cwd=ROOT, check=True, capture_output=True)
        empty = Path(made) / "empty.html"
        empty.write_text("<!doctype html><p>nothing</p>", encoding="utf-8")
        with sync_playwright() as p:
            browser = p.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
            base = first_paint(browser, empty)
            print(f"empty page: first paint {base:.0f} ms")
            for page in sorted(folder.rglob("*.html")):
                paint = first_paint(browser, page)
                tab = browser.new_page()
                tab.goto(page.as_uri())
                sheets = tab.pdf(prefer_css_page_size=True).count(b"/Type /Page\n")
                tab.close()
                weight = page.stat().st_size / 1e6
                print(
                    f"{page.relative_to(folder)}: {weight:.2f} MB, first paint {paint:.0f} ms ({paint / base:.1f} times empty), {sheets} pages A4"
                )
            browser.close()


if __name__ == "__main__":
    main()
