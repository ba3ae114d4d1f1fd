"""Pages in a real browser: nothing wider than the window, no error on the console, charts that answer. Skipped where no Chromium is installed."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insemu.report.charts import Chart, Line, View
from insemu.report.page import Card, Code, Folded, Items, Section, Table, Text, render

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def a_page(folder: Path) -> Path:
    """A page with every kind of block, hostile text among it."""
    x = np.linspace(0.0, 20.0, 400)
    hostile = "</script><script>document.title = 'broken'</script><b>bold</b>"
    views = [
        View(
            "rms",
            "error (m)",
            [
                Line("one", np.exp(x / 5), "#0072B2"),
                Line("two", 2 + np.sin(x), "#D55E00"),
                Line("two: bound", 4 + x, "#D55E00", dashed=True, of="two"),
            ],
            log_y=True,
        ),
        View(hostile, "error (m)", [Line("one", x, "#0072B2"), Line("two", x**2, "#D55E00")]),
    ]
    chart = Chart("Errors", "Errors of two designs. " + hostile, x, "time (min)", views, [(5.0, 7.0)])
    second = Chart("NEES", "NEES of two designs.", x, "time (min)", [View("NEES", "NEES", views[0].lines)])
    wide = Table(
        [f"column {k}" for k in range(14)],
        [["a long name", *("123.456" for _ in range(13))]] * 3,
        "A wide table. " * 12,
    )
    sections = [
        Section("Charts", [Text(hostile), chart, second]),
        Section("Tables", [wide, Folded("More", [Items(["one", "two"])])]),
        Section("Text", [Code("x" * 400)]),
    ]
    cards = [
        Card("one", "110 m (97 to 122)", "Knows its error", "good", ["24 states"]),
        Card("two", "325 m", "Optimistic", "bad"),
    ]
    return render(
        "A page",
        sections,
        folder / "page.html",
        answer="Take one: 110 m.",
        lead="A question.",
        cards=cards,
        footer="insemu",
    )


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if BROWSER is None:
        pytest.skip("no Chromium is installed")
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as p:
        started = p.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.mark.parametrize("width", [420, 768, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_wider_than_the_window_and_the_console_is_silent(
    browser: Any, tmp_path: Path, width: int, scheme: str
) -> None:
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on(
        "request", lambda request: said.append(request.url) if not request.url.startswith(("file:", "data:")) else None
    )
    page.goto(a_page(tmp_path).as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.title() == "A page"
    assert page.locator(".chart canvas").count() == 2
    assert said == []
    page.close()


def test_charts_hover_switch_and_share_what_is_off(browser: Any, tmp_path: Path) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 1400})
    page.goto(a_page(tmp_path).as_uri())
    first, second = page.locator(".chart").nth(0), page.locator(".chart").nth(1)
    box = first.locator(".u-over").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    values = first.locator(".u-legend .u-value").all_text_contents()
    assert float(values[0]) == pytest.approx(10.0, abs=0.2)
    assert float(values[1]) == pytest.approx(np.exp(2.0), rel=0.05)
    assert float(second.locator(".u-legend .u-value").nth(0).text_content()) == pytest.approx(
        10.0, abs=0.2
    )  # one cursor for both
    first.locator(".u-legend th", has_text="two").first.click()
    for row in second.locator(".u-series", has_text="two").all():  # the line and its bound
        assert "u-off" in row.get_attribute("class")
    first.locator("select").select_option(index=1)
    assert "u-off" in first.locator(".u-series", has_text="two").get_attribute("class")  # stays off in the other view
    page.close()


def test_charts_answer_the_keyboard_and_have_names(browser: Any, tmp_path: Path) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 1400})
    page.goto(a_page(tmp_path).as_uri())
    plot = page.locator(".chart .plot").first
    assert "Errors of two designs" in plot.get_attribute("aria-label")
    plot.focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    assert float(page.locator(".chart").first.locator(".u-legend .u-value").first.text_content()) == pytest.approx(
        3 * 20 / 399, rel=1e-3
    )
    page.close()
