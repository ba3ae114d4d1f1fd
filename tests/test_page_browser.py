"""Pages in a real browser: nothing wider than the window, no error on the console, charts that answer. Skipped where no Chromium is installed."""

from __future__ import annotations

import io
import json
import re
import shlex
import shutil
import threading
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from insemu.cli import main
from insemu.report.charts import Chart, Line, View, asset
from insemu.report.page import Card, Code, Folded, Items, Page, Section, Table, Text
from insemu.report.serve import server

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
    return Page(
        "A page",
        sections,
        kind="run",
        source="scenarios/s.yaml",
        answer="Take one: 110 m.",
        lead="A question.",
        cards=cards,
    ).write(folder / "page.html")


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
    assert page.title().startswith("A page (s.yaml, 20")
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
    assert "error (m) over time (min): one 1 to 54.6, largest at 20; two 1 to 3" in plot.get_attribute("aria-label")
    plot.focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    assert float(page.locator(".chart").first.locator(".u-legend .u-value").first.text_content()) == pytest.approx(
        3 * 20 / 399, rel=1e-3
    )
    page.close()


FLIGHT: dict[str, Any] = {
    "title": "A short flight",
    "seed": 3,
    "realizations": 2,
    "trajectory": {"builtin": "helicopter_mapping", "rate": "50 Hz", "duration": "120 s"},
    "truth": {"gyro": "WN(N=0.03 deg/s/sqrt(Hz))", "accel": "WN(N=90 ug/sqrt(Hz))"},
    "gnss": {"position_sigma": "5 cm", "velocity_sigma": "2 cm/s", "outages": [{"start": "80 s", "duration": "20 s"}]},
    "designs": {
        "wrong": {"gyro": "WN(N=0.3 deg/s/sqrt(Hz))", "accel": {"truth": True}},
        "right": {"gyro": {"truth": True}, "accel": {"truth": True}},
    },
    "smoother": True,
}
REST = {
    "title": "A sensor at rest",
    "seed": 5,
    "trajectory": {"builtin": "static", "rate": "50 Hz", "duration": "5 min"},
    "truth": {"gyro": "WN(N=0.3 deg/sqrt(h))", "accel": "WN(N=60 ug/sqrt(Hz))"},
    "designs": {"white": {"gyro": {"truth": True}, "accel": {"truth": True}}},
}
#: Two IMUs on one board, one with less noise, and their temperature: columns of one log, sampled together.
BOARD = {"gx": ("deg/s", 0.05), "gy": ("deg/s", 0.05), "ax": ("m/s^2", 0.01), "ay": ("m/s^2", 0.01)}


def write_board(path: Path) -> None:
    """Write a log of ten minutes at 20 Hz, in which the mean and the noise of the first IMU follow the temperature."""
    rng = np.random.default_rng(8)
    t = np.arange(12_000) / 20.0
    warm = 25.0 + 10.0 * np.sin(2 * np.pi * t / 300.0)
    columns = {"t [s]": t, "temperature [degC]": warm}
    for name, (unit, spread) in BOARD.items():
        drift = 0.02 * spread * (warm - 25.0) if name == "gx" else 0.0
        columns[f"{name}_1 [{unit}]"] = drift + spread * np.exp(0.05 * (warm - 25.0)) * rng.standard_normal(t.size)
        columns[f"{name}_2 [{unit}]"] = 0.5 * spread * rng.standard_normal(t.size)
    np.savetxt(path, np.column_stack(list(columns.values())), "%.8g", ",", header=",".join(columns), comments="")


HUM = [{"effect": "vibration_line", "sensor": "accel", "axes": ["x"], "amplitude": "1 mg", "frequency": "17.3 Hz"}]
#: A drive with outages of a minute, in which nothing is missing.
DRIVE: dict[str, Any] = {
    "title": "A drive",
    "seed": 4,
    "trajectory": {"builtin": "urban_drive_1", "rate": "20 Hz", "duration": "3 min"},
    "truth": {"gyro": "WN(N=0.6 deg/sqrt(h))", "accel": "WN(N=300 ug/sqrt(Hz))"},
    "gnss": {"position_sigma": "1 m", "velocity_sigma": "5 cm/s"},
    "designs": {"static": {"gyro": {"truth": True}, "accel": {"truth": True}}},
}
#: Page -> the commands that make it, one after the other in one folder.
KINDS = {
    "run/index.html": ["run flight.yaml --output run --workers 1"],
    "compare/index.html": ["compare flight.yaml --output compare --workers 1"],
    "sweep/index.html": [
        "sweep flight.yaml --over 'gnss.position_sigma=[5 cm, 1 m],outage=[10 s, 20 s]' --linear 50 --output sweep"
    ],
    "budget/index.html": ["compare flight.yaml --output budget --analytic"],
    "regress.html": [
        "regress record flight.yaml --baseline b.json --workers 1",
        "regress check flight.yaml --baseline b.json --workers 1 --page regress.html",
    ],
    "track.html": ["emulate flight.yaml --output flight.npz --page track.html"],
    "solve/index.html": ["solve flight.npz --output solve --workers 1"],
    "reckon.html": ["dead-reckon flight.npz --page reckon.html"],
    "char/index.html": ["emulate hum.yaml --output rest.npz", "characterise rest.npz --output char"],
    "fit.html": ["fit rest.npz --model WN() --page fit.html --workers 1"],
    "select.html": ["select rest.npz --general RW()+WN() --page select.html -c gyro_x,gyro_y --workers 1"],
    "gap/index.html": ["gap rest.yaml rest.npz --output gap"],
    "check/index.html": [
        "emulate drive.yaml --output drive.npz",
        "gap-check drive.yaml drive.npz --recordings 20 --no-search --output check",
    ],
    "follow.html": [
        "fit-covariate board.csv --model WN() --covariate temperature --segments 6 --page follow.html -c gx_1"
    ],
    "regressed.html": [
        "fit-regressors board.csv --model WN() --regressors temperature,time --page regressed.html -c gx_1"
    ],
    "array.html": ["array board.csv --model WN() --scenario flight.yaml --page array.html"],
}
#: Pages whose name is not that of their command.
OTHERWISE = ("budget", "char", "check", "track.html", "reckon.html", "follow.html", "regressed.html")
#: Those that take longer.
SLOW_KINDS = {
    "transfer.html": [
        "emulate drive.yaml --output drive.npz",
        "transfer drive.yaml drive.npz --no-why --page transfer.html",
    ],
}


def make_pages(folder: Path, kinds: dict[str, list[str]]) -> dict[str, str]:
    """Make pages by their commands, in a folder that is the current one; returns what each command printed."""
    written = {
        "flight.yaml": FLIGHT,
        "rest.yaml": REST,
        "hum.yaml": REST | {"truth": REST["truth"] | {"effects": HUM}},
        "drive.yaml": DRIVE,
    }
    for name, scenario in written.items():
        (folder / name).write_text(yaml.safe_dump(scenario, sort_keys=False), encoding="utf-8")
    write_board(folder / "board.csv")
    printed: dict[str, str] = {}
    for commands in kinds.values():
        for command in commands:
            out = io.StringIO()
            with pytest.raises(SystemExit) as end, redirect_stdout(out), redirect_stderr(out):
                main(shlex.split(command))
            assert end.value.code in (0, None), f"{command}\n{out.getvalue()}"
            printed[command] = out.getvalue()
    return printed


def _made(folder: Path, kinds: dict[str, list[str]]) -> tuple[Path, dict[str, str]]:
    if BROWSER is None:
        pytest.skip("no Chromium is installed")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("COLUMNS", "80")
        return folder, make_pages(folder, kinds)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """Every kind of page, and what the commands printed."""
    return _made(tmp_path_factory.mktemp("pages"), KINDS)


@pytest.fixture(scope="module")
def made(pages: tuple[Path, dict[str, str]]) -> Path:
    """Every kind of page."""
    return pages[0]


@pytest.fixture(scope="module")
def made_slowly(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The kinds that take longer."""
    return _made(tmp_path_factory.mktemp("slow_pages"), SLOW_KINDS)[0]


@pytest.mark.slow(reason="every kind of page in a browser")
def test_tables_on_the_terminal_keep_to_80_columns(pages: tuple[Path, dict[str, str]]) -> None:
    wide = []
    for command, text in pages[1].items():
        for line in text.splitlines():
            if len(line.rstrip()) > 80 and (re.search(r"\S {2,}\S", line) or re.search("[\u2500-\u257f]", line)):
                wide.append(f"{command}: {line}")  # prose wraps, a table does not
    assert wide == []


@pytest.mark.slow(reason="every kind of page in a browser")
@pytest.mark.parametrize("width", [420, 768, 1280])
@pytest.mark.parametrize("kind", SLOW_KINDS)
def test_a_page_that_takes_longer_fits_too(browser: Any, made_slowly: Path, kind: str, width: int) -> None:
    look_at(browser, made_slowly, kind, width)


@pytest.mark.slow(reason="every kind of page in a browser")
@pytest.mark.parametrize("width", [420, 768, 1280])
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_page_fits_is_silent_and_answers(browser: Any, made: Path, kind: str, width: int) -> None:
    look_at(browser, made, kind, width)


def look_at(browser: Any, made: Path, kind: str, width: int) -> None:
    """Open a page at a width; everything of it must fit, and every chart answer the keyboard."""
    page = browser.new_page(viewport={"width": width, "height": 900})
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto((made / kind).as_uri())
    for folded in page.locator("details").all():
        folded.evaluate("e => { e.open = true; }")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    if width == 1280:  # no table scrolls on a desk, and paper holds the page
        cut = "[...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.textContent.slice(0, 80))"
        assert page.evaluate(cut) == []
    assert len(page.locator(".answer").text_content()) > 20
    about = json.loads(page.locator("#about").text_content())
    assert about["kind"] in kind or kind.split("/")[0] in OTHERWISE
    assert ", insemu " in page.title() and (re.search("yaml|npz|csv", page.title()))
    charts = page.locator(".chart").all()
    assert charts
    for chart in charts:
        assert len(chart.locator(".plot").get_attribute("aria-label")) > 20
        chart.scroll_into_view_if_needed()
        assert chart.locator("canvas").count() == 1
        chart.locator(".plot").focus()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowRight")
        told = chart.locator(".u-value").all_text_contents() + chart.locator(".readout").all_text_contents()
        assert any(text.strip() not in ("", "--") for text in told), chart.locator("figcaption").text_content()
    assert said == []
    page.close()


@pytest.mark.slow(reason="every kind of page in a browser")
def test_the_map_and_the_charts_over_time_share_the_cursor(browser: Any, made: Path) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 1400})
    page.goto((made / "run/index.html").as_uri())
    growth = page.locator(".chart", has_text="Error growth.")
    growth.scroll_into_view_if_needed()
    box = growth.locator(".u-over").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    mark = page.locator(".chart", has_text="The reference from above").locator(".mark")
    mark.wait_for(state="visible", timeout=3000)
    first = mark.get_attribute("style")
    page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + box["height"] / 2)
    page.wait_for_timeout(100)
    assert mark.get_attribute("style") != first
    page.close()


@pytest.mark.slow(reason="every kind of page in a browser")
@pytest.mark.parametrize("kind", KINDS)
def test_a_page_prints_on_at_most_five_sheets(browser: Any, made: Path, kind: str) -> None:
    page = browser.new_page()
    page.goto((made / kind).as_uri())
    document = page.pdf(prefer_css_page_size=True)
    assert 1 <= document.count(b"/Type /Page\n") <= 5
    page.close()


@pytest.mark.slow(reason="every kind of page in a browser")
@pytest.mark.parametrize("width", [420, 768, 1280])
def test_the_list_of_pages_and_two_side_by_side_fit(browser: Any, made: Path, width: int) -> None:
    with server(made) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        root = f"http://127.0.0.1:{running.server_address[1]}"
        page = browser.new_page(viewport={"width": width, "height": 900})
        said: list[str] = []
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(root)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.locator("a[href='/run/index.html']").count() >= 1
        page.goto(f"{root}/side?left=run/index.html&right=compare/index.html")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        for frame, title in zip(page.frames[1:], ("A short flight", "Designs side by side"), strict=True):
            assert title in frame.locator("h1").text_content()
        assert said == []
        page.close()
        running.shutdown()


def _luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    r, g, b = (x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in parts)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_text_stands_out_of_its_ground_by_wcag_aa(scheme: int) -> None:
    block = re.findall(r":root \{(.*?)\}", asset("page.css"), re.S)[scheme]
    colours = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", block))
    for name in ("ink", "soft", "accent", "good", "warn", "bad"):
        for ground in ("paper", "wash"):
            high, low = sorted((_luminance(colours[name]), _luminance(colours[ground])), reverse=True)
            assert (high + 0.05) / (low + 0.05) >= 4.5, (name, ground)
