"""Many outages in a page, and logs that are read in pieces."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from insemu.cli import main
from insemu.formats import npz as npz_files
from insemu.formats import read_log, static
from insemu.report import experiment_charts
from insemu.report.charts import Chart, Ledger, Line, View
from insemu.report.page import Page, Section

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def a_ledger(count: int = 60) -> Ledger:
    charts = [
        Chart(f"Outage {k + 1}", "What it shows.", np.arange(4.0), "time (s)",
              [View("", "error (m)", [Line("one", np.arange(4.0) + k, "#0072B2"), Line("one: sigma", np.full(4, 2.0), "#0072B2", of="one")])],
              [(0.0, 3.0 + k)], group="outage")
        for k in range(count)
    ]  # fmt: skip
    rows = [[design, f"{k} min, 30 s", f"{(7 * k) % count + 0.5}"] for design in ("<one>", "two") for k in range(count)]
    return Ledger(["design", "outage", "error m"], rows, "All of them.", 2, charts, [*range(count)] * 2)


def test_a_ledger_holds_its_numbers_once(tmp_path: Path) -> None:
    ledger = a_ledger()
    html = Page("t", [Section("s", [ledger])], kind="run").write(tmp_path / "p.html").read_text(encoding="utf-8")
    assert "<one>" not in html
    found = json.loads(re.search(r'<div class="ledger">\s*<script type="application/json">(.*?)</script>', html)[1])
    assert found["rows"] == [list(r) for r in ledger.rows]
    name, spans, x, one, sigma = found["charts"][59]
    assert (name, spans, x, one, sigma) == ("Outage 60", [[0.0, 62.0]], [0, 1, 2, 3], [59, 60, 61, 62], [2, 2, 2, 2])
    assert found["of"][60 + 59] == 59
    assert [s["label"] for s in found["chart"]["views"][0]["series"]] == ["one", "one: sigma"]


@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed")
def test_every_row_is_reached(tmp_path: Path) -> None:
    sync = pytest.importorskip("playwright.sync_api")
    page = Page("t", [Section("s", [a_ledger()])], kind="run").write(tmp_path / "p.html")
    with sync.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": 420, "height": 900})
        wrong: list[str] = []
        tab.on("pageerror", lambda error: wrong.append(str(error)))
        tab.goto(page.as_uri())
        rows, said = tab.locator(".ledger .scroll tbody tr"), tab.locator(".ledger .bar span").first
        assert said.inner_text() == "1 to 25 of 120"
        seen = rows.all_inner_texts()
        for _ in range(4):
            tab.locator("button", has_text="Next").click()
            seen += rows.all_inner_texts()
        assert len(set(seen)) == 120
        tab.locator("th button", has_text="error m").click()
        assert rows.first.inner_text().split("\t")[2] == "0.5"
        tab.locator("th button", has_text="error m").click()
        assert rows.first.inner_text().split("\t")[2] == "59.5"
        tab.locator(".ledger input").fill("two")
        assert said.inner_text() == "1 to 25 of 60"
        tab.locator(".scroll tbody button").nth(2).click()
        row = rows.nth(2).inner_text().split("\t")
        assert tab.locator(".ledger figcaption").inner_text().startswith(f"Outage {int(row[1].split()[0]) + 1}.")
        assert tab.locator(".ledger canvas").count() == 1
        assert tab.evaluate("document.documentElement.scrollWidth") <= 420
        assert not wrong
        browser.close()


@pytest.mark.usefixtures("without_pictures")
def test_a_page_of_many_outages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run whose outages are too many to be shown: each is a row for every design with its chart, and few points stand in the others."""
    monkeypatch.setattr(experiment_charts, "MANY", 3)
    scenario = tmp_path / "s.yaml"
    outages = ", ".join(f"{{start: {60 + 60 * k} s, duration: {20 + k} s}}" for k in range(5))
    scenario.write_text(
        "title: many\nrealizations: 2\ntrajectory: {builtin: static, rate: 10 Hz, duration: 400 s}\n"
        "truth: {gyro: WN(N=0.1 deg/s/sqrt(Hz)), accel: WN(N=90 ug/sqrt(Hz))}\n"
        f"gnss: {{position_sigma: 1 m, outages: [{outages}]}}\n"
        "designs: {a: {gyro: {truth: true}, accel: {truth: true}}, b: {gyro: WN(N=1 deg/s/sqrt(Hz)), accel: {truth: true}}}\n"
    )
    with pytest.raises(SystemExit) as ended:
        main(["run", str(scenario), "--output", str(tmp_path / "out"), "--workers", "1"])
    assert ended.value.code in (0, None)
    html = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    found = json.loads(re.search(r'<div class="ledger">\s*<script type="application/json">(.*?)</script>', html)[1])
    assert [(r[0], r[1]) for r in found["rows"]] == [
        (d, f"{1 + k} min, {20 + k} s") for d in ("a", "b") for k in range(5)
    ]
    assert found["of"] == [0, 1, 2, 3, 4] * 2
    assert len(found["charts"]) == 5 and all(
        c[2][-1] == pytest.approx(20 + k, abs=0.11) for k, c in enumerate(found["charts"])
    )
    assert "Outage 3, realization 1" not in html  # no view of each outage


def test_a_stored_archive_is_mapped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(npz_files, "MAPPED", 1000)
    data = np.random.default_rng(1).standard_normal((500, 6))
    for name, save in (("stored", np.savez), ("packed", np.savez_compressed)):
        for order in ("C", "F"):
            file = tmp_path / f"{name}{order}.npz"
            save(file, data=np.asarray(data, order=order), fs=100.0)
            log = read_log(file)
            assert (static.mapping_of(log.columns[2]) is not None) == (name == "stored")
            np.testing.assert_array_equal(np.stack(log.columns, axis=1), data)
            np.testing.assert_array_equal(np.concatenate(list(log.chunks(4, 64, first=3))), data[3:, 4])


def test_a_fit_in_pieces_is_the_fit_of_the_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """The curve of the pieces is that of the whole up to octaves of 2^20 samples, so the fit is, too."""
    from insemu import logs

    monkeypatch.setattr(npz_files, "MAPPED", 1000)
    data = np.random.default_rng(2).standard_normal((20_000, 2)) * 1e-3
    np.savez(
        tmp_path / "log.npz", data=data, fs=100.0, columns=np.array(["gx", "ax"]), units=np.array(["rad/s", "m/s^2"])
    )
    said = []
    for most in (1 << 24, 10_000):
        monkeypatch.setattr(logs, "LONG", most)
        with pytest.raises(SystemExit):
            main(["fit", str(tmp_path / "log.npz"), "--model", "WN() + RW()", "--skip", "10 s", "--json"])
        said.append(json.loads(capsys.readouterr().out)["axes"])
    assert set(said[0]) == set(said[1]) == {"gyro_x", "accel_x"}
    for axis, one in said[0].items():
        assert one["n_samples"] == said[1][axis]["n_samples"] == 19_000
        for p, q in zip(one["parameters"], said[1][axis]["parameters"], strict=True):
            assert p["value"] == pytest.approx(q["value"], rel=1e-4)
