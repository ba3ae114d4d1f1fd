"""Stamps without rounding, the origin that a recording counts from, and what a drive becomes under three clocks."""

from __future__ import annotations

import bz2
import gzip
import json
import lzma
import runpy
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from insemu import formats
from insemu.errors import InputError
from insemu.formats import decoding, open_files, read_log, read_recording
from insemu.formats.clocks import start_said, utc_of
from insemu.intake import examine
from insemu.records import AidRecord, GnssRecord, ImuRecord, InitialState, Recording, Trajectory
from insemu.sample_times import beat, samples
from insemu.stamps import OWN, Origin, counted
from tests.shared_data import shared

#: GPS seconds of a week, s since 1970.
FAR = (345_600, 1_764_400_000)


@pytest.mark.parametrize("zero", [0, *FAR])
@pytest.mark.parametrize(("unit_s", "digits"), [(1.0, 6), (1e-3, 3), (1e-6, 0), (1e-9, 0)])
def test_stamps_are_counted_exactly_in_any_unit(zero: int, unit_s: float, digits: int) -> None:
    """Against decimal arithmetic: the text of a stamp, less the second of the first one, is the nearest float."""
    per = Decimal(str(unit_s))
    text = [str(round((Decimal(zero) + Decimal(7 + 9615 * k) / 1_000_000) / per, digits)) for k in range(400)]
    wanted = [float(Decimal(x) * per - zero) for x in text]
    whole = np.array([int(Decimal(x)) for x in text]) if digits == 0 else None
    for stamps in filter(lambda x: x is not None, (whole, np.array([float(x) for x in text]))):
        assert stamps is not None
        if unit_s == 1e-9 and stamps.dtype.kind == "f" and zero:
            continue  # float64 keeps 256 ns of them
        start, t = counted(stamps, unit_s)
        assert start == zero * 10**9 and t.tolist() == wanted


def test_stamps_that_are_no_decimals_keep_their_differences() -> None:
    t = 5.0 + np.arange(1000) / 104.0
    start, found = counted(t)
    assert start == 5 * 10**9
    np.testing.assert_array_equal(np.diff(found + 5.0), np.diff(t))
    start, found = counted(np.array([-0.25, 0.5]))
    assert start == -(10**9) and found.tolist() == [0.75, 1.5]
    start, found = counted(np.array([1.5, 3.0]), 60.0)
    assert start == 90 * 10**9 and found.tolist() == [0.0, 90.0]


def test_stamps_that_are_missing_stay_so() -> None:
    start, t = counted(np.array([np.nan, 12.5, 13.0]))
    assert start == 12 * 10**9 and t[1:].tolist() == [0.5, 1.0] and np.isnan(t[0])
    dates = np.array(["NaT", "2025-11-29T07:06:40.005000001", "2025-11-29T07:06:40.010"], dtype="datetime64[ns]")
    start, t = counted(dates)
    assert start == 1_764_400_000 * 10**9 and t[1:].tolist() == [0.005000001, 0.01] and np.isnan(t[0])
    for none in (np.array([np.nan]), np.array(["NaT"], dtype="datetime64[ns]"), np.zeros(0)):
        start, t = counted(none)
        assert start == 0 and t.size == none.size and not np.isfinite(t).any()


def test_a_start_is_said_in_utc() -> None:
    unix = 1_764_400_000 * 10**9
    gps = unix - 315_964_800 * 10**9 + 18 * 10**9
    assert utc_of(Origin(unix, "unix")) == utc_of(Origin(gps, "gps")) == 1_764_400_000.0
    said = "time 0 is 2025-11-29 07:06:40 UTC, GPS time 18 s ahead"
    assert start_said(Origin(unix, "unix")) == start_said(Origin(gps, "gps")) == said
    assert start_said(Origin(345_600 * 10**9, "sow")) == "time 0 is 345600 s of GPS seconds of the week"
    assert start_said(Origin(7 * 10**9)) == "time 0 is 7 s of the device's own clock"
    assert start_said(OWN) == "" and utc_of(Origin(5, "sow")) is None


def _recording(zero: float = 0.0) -> Recording:
    t = zero + np.round(np.arange(0.25, 30.0, 0.01), 2)
    fixes = zero + np.arange(1.0, 29.0)
    llh = np.tile([0.8, 0.1, 400.0], (fixes.size, 1))
    zeros = np.zeros((fixes.size, 3))
    imu = ImuRecord(t, np.full((t.size, 3), 0.1), np.tile([0.0, 0.0, -9.8], (t.size, 1)))
    aid = AidRecord("odometer", fixes, zeros[:, :1], zeros[:, :1] + 0.1, since=fixes - 0.5)
    initial = InitialState(zero + 1.0, llh[0], zeros[0], zeros[0], np.ones(9))
    return Recording(imu, GnssRecord(fixes, llh), Trajectory(fixes, llh, zeros, zeros), "made", (aid,), initial)


def _times(r: Recording) -> list[list[float]]:
    assert r.gnss is not None and r.reference is not None and r.initial is not None
    aid = r.aids[0]
    assert aid.since is not None
    return [x.tolist() for x in (r.imu.t, r.gnss.t, r.reference.t, aid.t, aid.since, np.array([r.initial.t]))]


@pytest.mark.parametrize("zero", FAR)
def test_a_recording_under_a_far_clock_counts_from_its_start(zero: int, tmp_path: Path) -> None:
    near, far = _recording(), _recording(zero)
    assert near.from_start() is near
    moved = far.from_start()
    assert _times(moved) == _times(near) and moved.origin == Origin(zero * 10**9)
    for name in ("r.npz", "folder"):
        formats.write(tmp_path / name, far)
        assert _times(read_recording(tmp_path / name)) == _times(far)  # what is written is read back
        named = replace(moved, origin=Origin(zero * 10**9, "unix"))
        formats.write(tmp_path / name, named)
        back = read_recording(tmp_path / name)
        assert back.origin == named.origin and _times(back) == _times(near)
        opened = open_files(tmp_path / name)
        assert opened.origin == named.origin and _times(replace(opened.recording(), initial=near.initial)) == _times(
            near
        )
    arrays = dict(np.load(tmp_path / "r.npz"))
    for change, said in (
        ({"origin_ns": np.array(1.5)}, "origin_ns: has type float64 and shape"),
        ({"origin_clock": np.array("tai")}, "origin_clock: unknown clock 'tai', expected one of: gps, sow, unix"),
    ):
        np.savez(tmp_path / "wrong.npz", **(arrays | change))
        with pytest.raises(InputError, match=said):
            read_recording(tmp_path / "wrong.npz")


@pytest.mark.parametrize("zero", [0, *(z * 10**9 for z in FAR)])
def test_steps_of_whole_nanoseconds_are_200_hz(zero: int, tmp_path: Path) -> None:
    """As text in ns and in s, as integers of a foreign archive, in a log at rest: whatever the clock counts from."""
    stamps = zero + 5_000_000 * np.arange(2000, dtype=np.int64)
    values = np.tile([0.01, 0.02, 0.03, 0.0, 0.0, -9.8], (stamps.size, 1))
    rows = [",".join(f"{v}" for v in row) for row in values]
    names = ",".join(formats.AXIS_OF_COLUMN)
    (tmp_path / "ns.csv").write_text("\n".join([f"stamp [ns],{names}", *map("{},{}".format, stamps.tolist(), rows)]))
    seconds = [f"{n // 10**9}.{n % 10**9:09d}" for n in stamps.tolist()]
    (tmp_path / "s.csv").write_text("\n".join([f"time [s],{names}", *map("{},{}".format, seconds, rows)]))
    savemat(tmp_path / "ns.mat", {"timestamp_ns": stamps, "gyro": values[:, :3], "accel": values[:, 3:]})
    for name in ("ns.csv", "s.csv", "ns.mat"):
        found = open_files(tmp_path / name)
        assert found.imu is not None
        np.testing.assert_array_equal(found.imu.t, np.arange(2000) / 200.0)
        assert found.origin.ns == zero and f"{1.0 / found.imu.dt:.9f}" == "200.000000000"
        (rate,) = (line.text for line in examine(found).lines if line.topic == "rate")
        assert rate.startswith("2000 samples at 200 Hz in 9.995 s, even steps")
    for name in ("ns.csv", "s.csv"):
        log = read_log(tmp_path / name)
        assert log.t is not None and log.rate_hz == 200.0 and not log.gaps()
        np.testing.assert_allclose(log.t, np.arange(2000) / 200.0, rtol=1e-14)


@pytest.mark.parametrize("rate", [64.0, 95.0, 100.0, 104.0, 119.0])
def test_the_rate_of_stamps_in_ms_is_that_of_the_sensor(rate: float, tmp_path: Path) -> None:
    t = np.round(np.arange(0.009, 600.0, 1.0 / rate), 3)
    assert abs(beat(t) * rate - 1.0) < 1e-8 and (samples(t, beat(t)) == 1.0).all()
    values = np.tile([0.01, 0.02, 0.03, 0.0, 0.0, -9.8], (t.size, 1))
    names = ",".join(f"{n} [{'rad/s' if n[0] == 'g' else 'm/s^2'}]" for n in formats.AXIS_OF_COLUMN)
    block = np.column_stack([t, values])
    np.savetxt(tmp_path / "log.csv", block, fmt="%.3f", delimiter=",", header=f"t [s],{names}", comments="")
    assert read_log(tmp_path / "log.csv").rate_hz == rate
    (line,) = (x for x in examine(open_files(tmp_path / "log.csv")).lines if x.topic == "rate")
    assert line.text.startswith(f"{t.size} samples at {rate:g} Hz")


def test_losses_are_told_from_late_stamps() -> None:
    """Jitter of a tenth of the interval loses nothing; what was taken out is counted, beside jitter too."""
    rng = np.random.default_rng(5)
    even = np.arange(60_000) * 0.01
    keep = rng.random(even.size) > 0.01
    keep[[0, -1]] = True
    late = 1e-3 * rng.standard_normal(even.size)
    for t, lost in ((even + late, 0), (even[keep], (~keep).sum()), ((even + late)[keep], (~keep).sum())):
        assert abs(beat(t) / 0.01 - 1.0) < 3e-5
        assert abs((samples(t, beat(t)) - 1.0).sum() - lost) <= 2
    assert np.isnan(beat(np.array([1.0]))) and beat(np.array([1.0, 3.0])) == 2.0


@pytest.mark.parametrize(
    ("suffix", "packed"),
    [
        (".gz", gzip.compress),
        *(
            pytest.param(*c, marks=pytest.mark.slow(reason="another case of a quick test"))
            for c in ((".bz2", bz2.compress), (".xz", lzma.compress))
        ),
    ],
)
def test_text_that_unpacks_to_far_more_than_its_size_is_refused(
    suffix: str, packed: Callable[[bytes], bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decoding, "UNPACKED", 1 << 20)
    names = ",".join(f"{n} [{'rad/s' if n[0] == 'g' else 'm/s^2'}]" for n in formats.AXIS_OF_COLUMN)
    head = f"t [s],{names}\n0,0,0,0,0,0,-9.8\n".encode()
    for name, text in (("line", head + b"1" * (2 << 20)), ("rows", head + b"1,0,0,0,0,0,-9.8\n" * (1 << 17))):
        path = tmp_path / f"{name}.csv{suffix}"
        path.write_bytes(packed(text))
        assert path.stat().st_size * decoding.RATIO < len(text)
        for door in (open_files, read_log):
            with pytest.raises(InputError, match=r"unpacks to more than 1 MiB, more than 100 times its \d+ bytes"):
                door(path)
    np.savez_compressed(tmp_path / "r.npz", imu_t=np.arange(3.0), imu=np.zeros((1 << 17, 6)))
    with pytest.raises(InputError, match=r"r\.npz: unpacks to more than 1 MiB"):
        formats.read(tmp_path / "r.npz")
    usual = tmp_path / f"usual.csv{suffix}"
    rows = np.column_stack([np.arange(40_000) / 100.0, np.random.default_rng(1).standard_normal((40_000, 6))])
    lines = "\n".join(",".join(f"{v:.6f}" for v in row) for row in rows)
    usual.write_bytes(packed(f"t [s],{names}\n{lines}\n".encode()))
    assert len(read_log(usual)) == 40_000 and len(lines) > 2 << 20


@pytest.mark.slow(reason="a whole solution of a drive, three times")
def test_a_drive_under_three_clocks_has_one_solution(tmp_path: Path) -> None:
    """One drive as three loggers write it: all figures agree, and the start is the only line that differs."""
    logger = runpy.run_path(str(shared("cases/logger/variants.py")))
    from tests.test_intake import run

    imu, fixes = logger["T"] < 200.0, logger["FIX_T"] < 200.0
    for name, zero in (("clean", 0.0), ("week", 345_600.0), ("unix", 1_764_400_000.0)):
        path = tmp_path / f"{name}_imu.csv"
        logger["write_imu"](path, logger["T"][imu] + zero, logger["ACCEL"][imu], logger["GYRO"][imu])
        path = tmp_path / f"{name}_gnss.csv"
        logger["write_gnss"](path, logger["FIX_T"][fixes] + zero, logger["LLH"][fixes], logger["VEL"][fixes])
    found = {}
    for name in ("clean", "week", "unix"):
        files = [tmp_path / f"{name}_{part}.csv" for part in ("imu", "gnss")]
        assert run("solve", files[0], "--gnss", files[1], "--output", tmp_path / name) == 0
        text = (tmp_path / name / "summary.json").read_text()
        summary = json.loads(text.replace(f"{name}_imu.csv", "imu.csv").replace(f"{name}_gnss.csv", "gnss.csv"))
        lines = summary["intake"].pop("lines")
        starts = [line["text"] for line in lines if line["topic"] == "start"]
        found[name] = (summary, [line for line in lines if line["topic"] != "start"], starts)
    for name, said in (
        ("week", "345600 s of the device's own clock"),
        ("unix", "2025-11-29 07:06:40 UTC, GPS time 18 s ahead"),
    ):
        _same(found["clean"][0], found[name][0])
        _same(found["clean"][1], found[name][1])
        assert found[name][2] == [f"time 0 is {said}"] and not found["clean"][2]


def _same(one: object, other: object) -> None:
    """Plain data with the same words, and the same numbers to 1e-9."""
    if isinstance(one, dict) and isinstance(other, dict):
        assert one.keys() == other.keys()
        for key in one:
            _same(one[key], other[key])
    elif isinstance(one, list) and isinstance(other, list):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            _same(a, b)
    elif isinstance(one, float) and isinstance(other, float):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
    else:
        assert one == other
