"""Protection levels, the regions of the Stanford diagram, and requirements as guards."""

import json
import math

import numpy as np
import pytest
import yaml
from scipy import stats

from insemu.cli import main
from insemu.errors import InputError
from insemu.evaluate.world import major_axis
from insemu.require import REGIONS, Guard, Requirement, protection_factor, recorded_guard

ASKED = Requirement("planimetric", 2.0, 0.95, 30.0)


def test_factors_are_those_of_the_standard():
    assert protection_factor(2, 5e-9) == pytest.approx(6.18, abs=0.005)
    assert protection_factor(1, 1e-7) == pytest.approx(5.33, abs=0.005)
    assert stats.chi2.sf(protection_factor(2, 0.05) ** 2, 2) == pytest.approx(0.05, rel=1e-12)


def test_every_flight_has_one_region():
    error, level = np.array([1.0, 1.5, 3.0, 1.0, 5.0, 3.0]), np.array([1.5, 1.0, 1.0, 3.0, 4.0, 3.5])
    guard = Guard(ASKED, "x", error, level)
    assert list(guard.regions.values()) == [1, 1, 1, 2, 1]
    assert set(guard.regions) == set(REGIONS)
    assert guard.within == 3


def test_a_requirement_is_broken_by_errors_and_by_what_bounds_them():
    good, level = np.full(100, 1.0), np.full(100, 1.5)
    assert Guard(ASKED, "x", good, level).kept
    assert not Guard(ASKED, "x", np.where(np.arange(100) < 6, 3.0, good), np.full(100, 4.0)).kept
    # all within the limit, but 12 of 100 above a protection level that 5 % may exceed: 6.4 % at least
    unsure = Guard(ASKED, "x", good, np.where(np.arange(100) < 12, 0.9, level))
    assert (unsure.within, unsure.exceeded, unsure.kept) == (100, 12, False)
    assert Guard(ASKED, "x", good, np.where(np.arange(100) < 9, 0.9, level)).kept


def test_the_short_form_is_the_same_requirement():
    assert Requirement.parse("95 % < 2 m after 30 s") == ASKED == Requirement.parse(ASKED.text)


def test_the_largest_axis_is_an_eigenvalue():
    rng = np.random.default_rng(5)
    A = rng.standard_normal((20, 9, 9))
    P = A @ A.transpose(0, 2, 1)
    assert np.allclose(major_axis(P), np.sqrt(np.linalg.eigvalsh(P[:, :2, :2])[:, 1]))


def test_outages_that_overlap_count_once():
    start, horizons = np.arange(100.0), np.array([10.0, 30.0])
    error, P = np.full((100, 2, 2), 1.0), np.tile(np.eye(2), (100, 2, 1, 1))
    guard = recorded_guard(ASKED, start, horizons, error, P)
    assert guard.error.size == 4
    assert guard.error == pytest.approx(math.sqrt(2.0))
    assert guard.protection == pytest.approx(protection_factor(2, 0.05))
    with pytest.raises(InputError, match="no outage of 60 s was cut, expected one of: 10 s, 30 s"):
        recorded_guard(Requirement("planimetric", 2.0, 0.95, 60.0), start, horizons, error, P)
    with pytest.raises(InputError, match="found 'height'"):
        recorded_guard(Requirement("height", 2.0, 0.95, 30.0), start, horizons, error, P)


SCENARIO = {
    "title": "guarded", "seed": 3, "realizations": 8,
    "trajectory": {"builtin": "urban_drive_1", "rate": "50 Hz", "begin": "220 s", "duration": "290 s"},
    "truth": {"gyro": "WN(N=0.3 deg/sqrt(h))", "accel": "WN(N=100 ug/sqrt(Hz)) + RC(sigma=1 mg)"},
    "gnss": {"rate": "1 Hz", "position_sigma": "1 m", "velocity_sigma": "0.1 m/s", "outages": [{"start": "250 s", "duration": "30 s"}]},
    "designs": {"right": {"gyro": {"truth": True}, "accel": {"truth": True}}},
}  # fmt: skip


def _check(tmp_path, require):
    args = [
        "regress",
        "check",
        str(tmp_path / "s.yaml"),
        "--baseline",
        str(tmp_path / "b.json"),
        "--workers",
        "1",
        "--json",
    ]
    with pytest.raises(SystemExit) as end:
        main([*args, "--require", require, "--page", str(tmp_path / "page.html")])
    return end.value.code


def test_a_regression_check_holds_a_requirement(tmp_path, capsys):
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(SCENARIO))
    with pytest.raises(SystemExit) as end:
        main(["regress", "record", str(tmp_path / "s.yaml"), "--baseline", str(tmp_path / "b.json"), "--workers", "1"])
    assert end.value.code == 0
    capsys.readouterr()
    assert _check(tmp_path, "90 % < 500 m after 30 s") == 0
    out = capsys.readouterr().out
    (found,) = json.loads(out[: out.rindex("}") + 1])["required"]
    assert found["kept"]
    assert found["flights"] == found["within"] == 8
    assert sum(found["regions"].values()) == 8
    assert "Stanford diagram" in (tmp_path / "page.html").read_text()
    assert _check(tmp_path, "90 % < 1 cm after 30 s") == 1
    assert "is broken: 0 of 8 within the limit" in capsys.readouterr().err
    assert _check(tmp_path, "90 % < 1 m after 20 s") == 2
    assert "no outage lasts 20 s, expected one of: 30 s" in capsys.readouterr().err
