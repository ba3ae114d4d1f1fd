"""Screenshots of every kind of page at three widths: python -m tests.page_screenshots (writes results/gallery/pages/KIND.png)."""

from __future__ import annotations

import io
import os
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from tests.test_page_browser import BROWSER, KINDS, make_pages

WIDTHS = (420, 768, 1280)
#: Height of what is shown of a page, and by how much it is made smaller.
HEIGHT, SCALE, COLOURS = 1200, 0.4, 48
TARGET = Path(__file__).resolve().parent.parent / "results" / "gallery" / "pages"


def main() -> None:
    TARGET.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as p:
        os.chdir(folder)
        make_pages(Path(folder))
        browser = p.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        for kind in KINDS:
            sheet = Image.new("RGB", (int(SCALE * (sum(WIDTHS) + 20 * len(WIDTHS))), int(SCALE * HEIGHT)), "#888888")
            left = 0
            for width in WIDTHS:
                page = browser.new_page(viewport={"width": width, "height": HEIGHT})
                page.goto((Path(folder) / kind).as_uri())
                page.wait_for_timeout(300)
                shot = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
                sheet.paste(shot.resize((int(SCALE * width), int(SCALE * HEIGHT)), Image.Resampling.LANCZOS), (left, 0))
                left += int(SCALE * (width + 20))
                page.close()
            name = TARGET / f"{kind.split('/')[0].removesuffix('.html')}.png"
            sheet.quantize(COLOURS).save(name, optimize=True)
            print(f"{name.name}: {name.stat().st_size / 1e3:.0f} kB")
        browser.close()


if __name__ == "__main__":
    main()
