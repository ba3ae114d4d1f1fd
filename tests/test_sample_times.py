"""When samples were taken, against the times at which they were: every kind of stamp on samples whose times are known."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from insemu import formats
from insemu.errors import InputError
from insemu.filters import LooselyCoupledEKF
from insemu.formats import open_files, read_log
from insemu.formats.clocks import clock_digits
from insemu.noise import WN
from insemu.records import ImuRecord
from insemu.sample_times import beat, continuous, sample_times, samples
from tests.shared_data import shared

Array = NDArray[np.float64]

N = 20_000
EVEN = 7.0 + np.arange(N) * 0.01
RNG = np.random.default_rng(11)
NOISE, DELAY = RNG.standard_normal(N), RNG.exponential(1.0, N)
WANDERING = 7.0 + np.cumsum(0.01 * (1.0 + 0.04 * np.sin(2 * np.pi * EVEN / 60.0)))


def _held_up() -> Array:
    """Rows that wait for 1.5 s in a buffer, three times."""
    t = EVEN + 5e-4 * DELAY
    for k in (2000, 9000, 15_000):
        t[k : k + 150] = t[k + 150] + 1e-5 * np.arange(150)
    return np.maximum.accumulate(t)


#: Stamps, the times of the samples, how far an offset common to all may be (s), how far a sample may scatter about it (rms, s).
#: Rounding to q over N samples leaves q sqrt(4/12/N) of a line, jitter 2 sigma/sqrt(N); a spline of one knot a second ten times that.
CASES: dict[str, tuple[Callable[[], Array], Array, float, float]] = {
    "rounded to ms at 104 Hz": (lambda: np.round(np.arange(N) / 104.0, 3), np.arange(N) / 104.0, 1e-5, 1e-5),
    "rounded to ms at 900 Hz": (lambda: np.round(np.arange(N) / 900.0, 3), np.arange(N) / 900.0, 5e-5, 1e-5),
    "jitter": (lambda: EVEN + 1e-3 * NOISE, EVEN, 5e-5, 5e-5),
    "jitter of a wandering rate": (lambda: WANDERING + 1e-3 * NOISE, WANDERING, 1e-4, 2e-4),
    "wandering rate": (lambda: WANDERING, WANDERING, 0.0, 0.0),
    "received": (lambda: np.maximum.accumulate(EVEN + 0.005 * DELAY), EVEN, 5e-4, 3e-4),
    "held up": (_held_up, EVEN, 5e-4, 3e-4),
    "ten rows a stamp": (lambda: np.repeat(EVEN[9::10], 10), EVEN, 5e-4, 1e-4),
    "whole seconds": (lambda: np.floor(EVEN), EVEN, 0.03, 2e-3),
    "jitter that goes back": (lambda: EVEN + 4e-3 * NOISE, EVEN, 1e-4, 1e-4),
}


@pytest.mark.parametrize("case", CASES)
def test_every_row_is_put_where_its_sample_was(case: str) -> None:
    made, true, offset, scatter = CASES[case]
    found = sample_times(made())
    error = found.t - true
    assert found.rows.tolist() == list(range(true.size)) and found.lost == 0 and (np.diff(found.t) > 0.0).all()
    assert abs(error.mean()) <= offset and error.std() <= scatter
    assert abs(beat(found.t) / beat(true) - 1.0) <= 4.0 * scatter / (true[-1] - true[0]) + 1e-12


@pytest.mark.parametrize(("jitter", "wrong"), [(0.0, 0), (1e-3, 0), (2e-3, 2)])
def test_losses_are_counted_beside_jitter(jitter: float, wrong: int) -> None:
    keep = np.random.default_rng(2).random(N) > 0.01
    keep[[0, -1]] = True
    t = (EVEN + jitter * NOISE)[keep]
    found = sample_times(t)
    assert abs(found.lost - int((~keep).sum())) <= wrong and abs(found.interval / 0.01 - 1.0) < 2e-5 * (1 + 4 * wrong)
    assert found.t.size == t.size


def test_a_loop_that_waits_is_believed() -> None:
    """Steps that scatter by themselves leave stamps that are right: what one has too much the next has not too little."""
    t = np.cumsum(0.01 + 1e-3 * NOISE)
    found = sample_times(t)
    np.testing.assert_array_equal(found.t, t)
    assert found.lost == 0 and not found.said


def test_a_gap_and_what_follows_it_are_two_things() -> None:
    """A gap is long by its step; rows that come at once behind it make up for it."""
    assert samples(np.r_[np.arange(40) * 0.01, 0.6 + np.arange(40) * 0.01], 0.01)[39] == 21.0
    held = np.arange(80) * 0.01
    held[40:60] = held[60] - 1e-4 * np.arange(20, 0, -1)
    assert (samples(held, 0.01) == 1.0).all()


@pytest.mark.parametrize(
    ("modulus", "unit_s"), [(2**32, 1e-6), (2**16, 1e-3), (10**6, 1e-6), (86_400, 1.0), (604_800, 1.0), (2**16, 1e-4)]
)
def test_counters_and_calendars_that_begin_again_go_on(modulus: int, unit_s: float) -> None:
    step = round(0.01 / unit_s) * unit_s if unit_s < 1.0 else 0.01
    true = modulus * unit_s - 3.0 * step * 100 + step * np.arange(3000)
    t, said = continuous(np.mod(true, modulus * unit_s), unit_s)
    np.testing.assert_allclose(t - t[0], true - true[0], atol=1e-6)
    assert said[-1].startswith(f"the stamps begin again after {modulus * unit_s:.10g} s")


def test_a_clock_that_is_set_back_loses_no_row_and_rows_out_of_order_are_put_in_order() -> None:
    t = np.arange(3000) * 0.01
    back = t - 17.3 * (t > 20.0)
    np.testing.assert_allclose(continuous(back)[0], t, atol=1e-9)
    late = np.arange(3000)
    late[500:503] = [502, 500, 501]
    found = sample_times(continuous(t[late])[0])
    np.testing.assert_allclose(t[late][found.rows], t)
    twice = np.sort(np.r_[t, t[100:400]])
    same = np.concatenate([[False], np.diff(twice) == 0.0])
    found = sample_times(twice, same)
    assert found.t.size == t.size and "used once" in found.said[0]
    assert sample_times(twice).t.size == twice.size  # rows with values of their own are samples of their own
    with pytest.raises(InputError, match="is another column the time"):
        sample_times(RNG.standard_normal(300))


@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_digits_of_a_clock_pass_the_minute(unit: float) -> None:
    seconds = 45_290.0 + np.arange(4000) * 0.01  # 12:34:50
    digits = np.floor(seconds / 3600) * 10_000 + np.floor(np.mod(seconds, 3600) / 60) * 100 + np.mod(seconds, 60.0)
    found = clock_digits(np.round(digits / unit, 3 if unit == 1.0 else 0))
    assert found is not None
    np.testing.assert_allclose(found, seconds, atol=1e-6)
    assert clock_digits(seconds / unit) is None


def _written(path: Path, t: list[str], head: str) -> Path:
    values = np.round(0.01 * RNG.standard_normal((len(t), 6)) + [0, 0, 0, 0, 0, -9.8], 6)
    rows = [f"{a},{','.join(map(str, row))}" for a, row in zip(t, values.tolist(), strict=True)]
    path.write_text("\n".join([f"{head},wx [rad/s],wy [rad/s],wz [rad/s],fx [m/s^2],fy [m/s^2],fz [m/s^2]", *rows]))
    return path


def test_days_of_calendars_and_digits_of_clocks_are_read(tmp_path: Path) -> None:
    seconds = np.arange(7000) * 0.01
    for name, zero in (("Excel", 25_569.0), ("MATLAB", 719_529.0), ("modified Julian", 40_587.0)):
        days = [f"{zero + 19_800.5 + s / 86_400.0:.10f}" for s in seconds.tolist()]
        found = open_files(_written(tmp_path / "days.csv", days, "time"))
        assert found.imu is not None and len(found.imu) == 7000 and any(name in text for text in found.assumed)
        assert abs(1.0 / found.imu.dt - 100.0) < 1e-3 and found.origin.clock == "unix"
        assert abs(found.origin.ns / 1e9 + found.imu.t[0] - 19_800.5 * 86_400.0) < 1e-3
    digits = [f"12{30 + k // 6000:02d}{k % 6000 * 10:05d}" for k in range(7000)]
    found = open_files(_written(tmp_path / "digits.csv", digits, "utc"))
    assert found.imu is not None and len(found.imu) == 7000
    np.testing.assert_allclose(found.imu.t - found.imu.t[0], seconds, atol=1e-9)


def test_remarks_travel_with_a_recording_and_a_log(tmp_path: Path) -> None:
    stamps = [f"{t:.3f}" for t in (np.arange(4000) / 104.0).tolist()]
    found = open_files(_written(tmp_path / "ms.csv", stamps, "t [s]")).recording()
    assert any("rounded to 1 ms: samples are put at 104 Hz" in text for text in found.remarks)
    np.testing.assert_allclose(found.imu.t, np.arange(4000) / 104.0, atol=2e-5)
    own = tmp_path / "own.csv"
    own.write_text((tmp_path / "ms.csv").read_text().replace("w", "g").replace(",f", ",a"))
    log = read_log(own)
    assert log.rate_hz == 104.0 and any("104 Hz" in text for text in log.remarks) and not log.gaps()


def test_rows_with_one_sensor_each_are_all_used(tmp_path: Path) -> None:
    lines = ["t,wx,wy,wz,fx,fy,fz"]
    for k in range(2000):
        lines.append(f"{k * 0.01:.3f},{k * 1e-4},0,0,,,")
        if k % 2 == 0:
            lines.append(f"{k * 0.01 + 0.003:.3f},,,,0,{k * 1e-4},-9.8")
    (tmp_path / "both.csv").write_text("\n".join(lines))
    found = open_files(tmp_path / "both.csv").imu
    assert found is not None and abs(found.dt - 0.01) < 1e-6 and len(found) >= 1997
    np.testing.assert_allclose(found.accel[:, 1], (found.t - 0.003) / 0.01 * 1e-4, atol=1e-4)


def test_a_belief_is_discretised_at_the_rate_of_the_recording() -> None:
    """At another rate than the filter was made for, it flies as one made for it."""
    t = np.arange(2000) * 0.02
    imu = ImuRecord(t, np.zeros((t.size, 3)), np.tile([0.0, 0.0, -9.8], (t.size, 1)), "mean")
    belief = {axis: WN(N=1e-4) for axis in formats.AXIS_OF_COLUMN.values()}
    other = LooselyCoupledEKF(belief, 0.01).at_rate_of(imu)
    assert other.dt == imu.dt and other.at_rate_of(imu) is other


@pytest.mark.parametrize(
    ("name", "rate"), [("F17_bursts", 100.0), ("F18_sbg_us_wrap", 100.0), ("F26_excel_serial", 100.0)]
)
def test_files_as_users_have_them_keep_every_row(name: str, rate: float, tmp_path: Path) -> None:
    import tarfile

    with tarfile.open(shared(f"cases/{name}.csv.tar.xz")) as packed:
        packed.extractall(tmp_path, filter="data")
    found = open_files(tmp_path / f"{name}.csv").imu
    assert found is not None and len(found) == 20_000
    assert abs(1.0 / found.dt - rate) < 1e-3 and abs(found.t[-1] - found.t[0] - 199.99) < 2e-3


@pytest.mark.parametrize(
    ("share", "delay"), [(0.0, 0.005), (0.001, 0.005), (0.01, 0.002), (0.01, 0.005), (0.03, 0.005)]
)
def test_losses_are_counted_among_stamps_of_reception(share: float, delay: float) -> None:
    """Delays of half an interval hide a lost sample from every step of its own; the likeliest sequence of losses does not miss it."""
    rng, n, interval = np.random.default_rng(5), 30_000, 0.01 * (1.0 + 3e-5)
    kept = rng.random(n) >= share
    true = interval * np.flatnonzero(kept)
    found = sample_times(np.round(np.maximum.accumulate(true + 0.015 + rng.exponential(delay, true.size)), 4))
    lost = round(true[-1] / interval) - round(true[0] / interval) + 1 - true.size
    assert abs(found.lost - lost) <= 1
    assert abs(found.interval / interval - 1.0) < 5e-6
    assert found.t.size == true.size and np.std(found.t - true) < 0.15 * interval


def test_a_far_longer_gap_than_all_samples_costs_no_memory() -> None:
    """The grids of the clock grow with the rows, not with the time that they span."""
    delays = np.random.default_rng(3).exponential(0.004, 4000)
    t = np.arange(4000) * 0.01 + delays
    t[2000:] += 3e4
    tracemalloc.start()
    found = sample_times(t)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e4 * t.size
    assert np.abs(found.t - t).max() < 0.1 and (np.diff(found.t) > 0.0).all()
    # the interval is that of blocks of 64 rows, whose ends scatter by 4 ms each: five standard errors of the median of 62 of them
    assert found.lost == pytest.approx(3e6, rel=5 * 1.25 * np.sqrt(2 / 62) * 0.004 / 0.64)
