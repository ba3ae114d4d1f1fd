"""Screenshots of every kind of page at three widths: python -m tests.page_screenshots [FOLDER] (writes results/gallery/pages/KIND.png).

The pages are made anew, or taken from a folder in which the commands of tests/test_page_browser.py made them.
"""

from __future__ import annotations

import io
import os
import sys
import tempfile
import threading
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, sync_playwright

from insemu.report.serve import server
from tests.test_page_browser import BROWSER, KINDS, SLOW_KINDS, make_pages

WIDTHS = (420, 768, 1280)
#: Height of what is shown of a page, and by how much it is made smaller.
HEIGHT, SCALE, COLOURS = 1200, 0.4, 64
TARGET = Path(__file__).resolve().parent.parent / "results" / "gallery" / "pages"


def sheet_of(browser: Browser, address: str, name: str) -> None:
    """Write a page at every width, side by side."""
    sheet = Image.new("RGB", (int(SCALE * (sum(WIDTHS) + 20 * len(WIDTHS))), int(SCALE * HEIGHT)), "#888888")
    left = 0
    for width in WIDTHS:
        page = browser.new_page(viewport={"width": width, "height": HEIGHT})
        page.goto(address)
        page.wait_for_timeout(300)
        shot = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        sheet.paste(shot.resize((int(SCALE * width), int(SCALE * HEIGHT)), Image.Resampling.LANCZOS), (left, 0))
        left += int(SCALE * (width + 20))
        page.close()
    file = TARGET / f"{name}.png"
    few = sheet.quantize(
        COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
    )  # thin lines keep their colours
    few.save(file, optimize=True)
    print(f"{file.name}: {file.stat().st_size / 1e3:.0f} kB")


def main() -> None:
    TARGET.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as p:
        os.chdir(folder)
        root = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(folder)
        if root == Path(folder):
            make_pages(root, KINDS | SLOW_KINDS)
        browser = p.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        for kind in (*KINDS, *SLOW_KINDS):
            sheet_of(browser, (root / kind).as_uri(), kind.split("/")[0].removesuffix(".html"))
        with server(root) as running:
            threading.Thread(target=running.serve_forever, daemon=True).start()
            sheet_of(browser, f"http://127.0.0.1:{running.server_address[1]}/", "serve")
            running.shutdown()
        browser.close()


if __name__ == "__main__":
    main()
