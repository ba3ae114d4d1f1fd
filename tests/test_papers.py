"""The page of the papers: verdicts follow from cells and statements, parts are kept, absent data is said."""

from __future__ import annotations

import copy
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from benchmarks.papers.__main__ import main, printed_numbers
from benchmarks.papers.exhibit import PAPERS, Cell, Content, Statement
from benchmarks.papers.words import FUNCTIONS, Claim, cell, claims
from insemu.scenario import load
from tests.shared_data import shared

GOOD, BAD = Cell("a", 1.0, 1.1, 0.9, 1.3), Cell("b", 1.0, 2.0, 1.5, 2.5)
HOLDS, FAILS = Statement("x", "1", True), Statement("y", "0", False)


@pytest.mark.parametrize(
    ("content", "verdict"),
    [
        (Content([GOOD], [HOLDS]), "reproduced"),
        (Content([GOOD]), "reproduced"),
        (Content([GOOD, BAD], [HOLDS]), "reproduced in kind"),
        (Content([], [HOLDS]), "reproduced in kind"),
        (Content([GOOD], [HOLDS, FAILS], "of the streets"), "not, because of the streets"),
        (Content([BAD], [], "of rounding"), "not, because of rounding"),
    ],
)
def test_a_verdict_follows_from_what_was_measured(content: Content, verdict: str) -> None:
    assert content.verdict == verdict
    assert Content.decode(content.encode()) == content


def test_a_cell_agrees_inside_its_interval_or_its_tolerance() -> None:
    assert GOOD.agrees and not BAD.agrees
    assert Cell("c", 1.0, 1.15, 1.1, 1.2, tolerance=0.2).agrees
    drawn = Cell.of_draws("d", 10.0, [-1.0, 1.0, 3.0])
    assert (drawn.ours, drawn.low, drawn.high) == pytest.approx((1.0, -5.0, 7.0))
    signed = Cell.of_draws("e", -1.0, [-1.0, -math.e, -(math.e**2)])
    assert (signed.ours, signed.low, signed.high) == pytest.approx((-math.e, -(math.e**4), -(math.e**-2)))


def test_the_command_prints_and_keeps_its_parts(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setenv("INSEMU_SHARED", str(shared("published").parent))
    monkeypatch.setattr("sys.argv", ["papers", "--only", "mems2013/Table 8", "--out", str(tmp_path)])
    main()
    first = capsys.readouterr()
    assert "5 of 5 cells agree" in first.out and "27AR: printed 27, ours 27" in first.out
    assert "mems2013/Table 8 ..." in first.err
    main()
    assert "mems2013/Table 8 ..." not in capsys.readouterr().err
    assert "27AR" in (tmp_path / "index.html").read_text()


def test_papers_whose_numbers_are_absent_are_skipped_and_said(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setenv("INSEMU_SHARED", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["papers", "--only", "mems2013/Table 8", "--out", str(tmp_path / "page")])
    main()
    said = capsys.readouterr().out
    assert "skipped, its printed numbers are not in" in said and "0 of 0 exhibits" in said


def test_the_scenario_of_table_3_has_the_printed_numbers_the_way_round_that_the_text_means() -> None:
    table = yaml.safe_load(shared("published/stebler2014.yaml").read_text(encoding="utf-8"))
    printed = table["table_3_mean_planimetric_error_at_outage_end_m"]
    published = load("table3_synthetic").published
    assert published is not None and published.planimetric_end_m is not None
    assert {name.replace(" ", "_"): list(row) for name, row in published.planimetric_end_m.items()} == printed
    gains = [1.0 - printed["model_3"][outage] / printed["model_2"][outage] for outage in (1, 2)]
    assert gains == pytest.approx([0.28, 0.52], abs=0.005)


#: What contradicts itself, by the beginning of the claim.
CONTRADICTIONS = {
    "gmwm2014": {
        "100 Hz during 4 hr",
        "estimated by GMWM",
        "and 91.6 ug",
        "our estimated sigma_WN",
        "the manufacturer's",
    },
    "em2011": {"better bounded"},
    "ml2016": {"400 Hz"},
    "platform2016": set(),
    "mems2013": {"coefficients are computed"},
}


@pytest.mark.parametrize("paper", PAPERS)
def test_what_papers_say_of_their_own_cells(paper: str) -> None:
    found = claims(paper, printed_numbers(shared("published").parent, paper) or {})
    wrong = {c.says for c in found if not c.follows}
    assert len(found) > len(wrong) or paper == "em2011"
    assert len(wrong) == len(CONTRADICTIONS[paper])
    assert all(any(says.startswith(start) for says in wrong) for start in CONTRADICTIONS[paper])


def test_the_exchanged_labels_of_table_3_are_caught() -> None:
    printed = printed_numbers(shared("published").parent, "gmwm2014") or {}
    labelled = copy.deepcopy(printed)
    rows = np.array(list(printed["table_3_as_labelled"].values()))  # a row is an outage, a column a model
    for model, column in enumerate(rows.T, 1):
        labelled["table_3_mean_planimetric_error_at_outage_end_m"][f"model_{model}"] = column.tolist()
    table = [{c.says: c for c in claims("gmwm2014", numbers)} for numbers in (printed, labelled)]
    changed = [says for says, c in table[0].items() if c.follows and not table[1][says].follows]
    starts = ("model 3 outperforms", "about 52 % at the third", "model 2 performs only", "the first GM process")
    assert len(changed) == len(starts) and all(c.startswith(s) for c, s in zip(changed, starts, strict=True))
    assert table[1]["about 52 % at the third"].computed == pytest.approx([55.7, 37.6], abs=0.05)


def test_a_claim_follows_inside_its_words_and_cells_are_found_by_path() -> None:
    one = Claim("x", "", np.array([1.0, 3.0]), 0.5, 2.0)
    assert not one.follows and Claim("x", "", one.computed, 0.5, 2.0, any=True).follows
    assert one.measured == "1, 3" and one.verdict == "contradicts"
    printed = {"a": {"b": [{"c": 1}, {"c": 2}]}, "eff_0.6": {"d": 3}, 4: [5]}
    assert cell(printed, "a.b.*.c") == [1, 2] and cell(printed, "eff_0.6.d") == 3 and cell(printed, "4.0") == 5


def test_white_noise_alone_is_the_weighted_mean_level_of_the_curve() -> None:
    flat = {"sigma_wn": [0.03, "deg/s/sqrt(Hz)"], "gm": []}
    assert FUNCTIONS["white_alone"](flat) == pytest.approx([0.03] * 9)
    fast = {"sigma_wn": [1e-9, "deg/s/sqrt(Hz)"], "gm": [{"beta": [1e5, "Hz"], "sigma": [2.0, ""]}]}  # white at 100 Hz
    found = FUNCTIONS["white_alone"](fast)
    assert found[:3] == pytest.approx([2.0 * math.sqrt(0.01)] * 3) and found[6:] == pytest.approx([2.0] * 3)
