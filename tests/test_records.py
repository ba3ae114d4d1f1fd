"""Typed records check what comes in."""

from __future__ import annotations

import numpy as np
import pytest

from insemu.errors import InputError, nearest
from insemu.records import AidRecord, GnssRecord, ImuRecord, InitialState, Series, Trajectory


def test_series_is_frozen_and_checked() -> None:
    values = np.arange(3.0)
    s = Series(values, 100.0, "rad/s", "gyro_x")
    assert s.dt == 0.01
    assert len(s) == 3
    with pytest.raises(ValueError, match="read-only"):
        s.values[0] = 1.0
    values[0] = 7.0  # the caller's array stays writable
    with pytest.raises(InputError, match=r"gyro_x has 1 value\(s\) that are not finite, the first at row 2"):
        Series(np.array([0.0, 1.0, np.nan]), 100.0, name="gyro_x")
    with pytest.raises(InputError, match="positive"):
        Series(values, 0.0)
    with pytest.raises(InputError, match="shape"):
        Series(np.zeros((2, 2)), 1.0)
    with pytest.raises(InputError, match="real numbers"):
        Series(np.array(["a"]), 1.0)


def test_times_must_increase() -> None:
    for t, word in (([0.0, 0.0], "repeats"), ([1.0, 0.0], "goes back")):
        with pytest.raises(InputError, match=word):
            ImuRecord(np.array(t), np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(InputError, match="has steps of 5e-310 s; expected at least 1e-12 s"):
        ImuRecord(np.array([0.0, 5e-310, 1e-309, 1.0]), np.zeros((4, 3)), np.zeros((4, 3)))
    with pytest.raises(InputError, match=r"runs from 0 to 1e\+300 s; expected times within 1e\+24 s"):
        ImuRecord(np.array([0.0, 1e300]), np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(InputError, match="empty"):
        ImuRecord(np.array([]), np.zeros((0, 3)), np.zeros((0, 3)))
    with pytest.raises(InputError, match="expected one of: increment, mean, sample"):
        ImuRecord(np.array([0.0]), np.zeros((1, 3)), np.zeros((1, 3)), "rate")  # type: ignore[arg-type]


def test_means_and_samples_become_increments() -> None:
    t = np.array([0.0, 0.1, 0.3])
    rate = np.array([[1.0, 0, 0], [3.0, 0, 0], [5.0, 0, 0]])
    mean = ImuRecord(t, rate, 2 * rate, "mean").as_increments()
    np.testing.assert_allclose(mean.gyro[:, 0], [0.3, 0.3, 1.0])
    np.testing.assert_allclose(mean.accel[1:, 0], [0.6, 2.0])
    sample = ImuRecord(t, rate, rate, "sample").as_increments()
    np.testing.assert_allclose(sample.gyro[1:, 0], [0.2, 0.8])
    assert sample.as_increments() is sample


def test_gnss_allows_absent_fixes_only_as_nan() -> None:
    llh = np.array([[0.8, 0.1, 10.0], [np.nan] * 3])
    assert len(GnssRecord(np.array([0.0, 1.0]), llh)) == 2
    with pytest.raises(InputError, match=r"latitude of 45 rad \(2578.31 deg\), expected -pi/2 to pi/2 rad"):
        GnssRecord(np.array([0.0]), np.array([[45.0, 9.0, 100.0]]))
    with pytest.raises(InputError, match="not finite"):
        Trajectory(np.array([0.0, 1.0]), llh, np.zeros((2, 3)), np.zeros((2, 3)))


def test_hints() -> None:
    assert nearest("lenght", ["length", "rate"]) == " (did you mean 'length'?)"
    assert nearest("zzz", ["b", "a"]) == " (expected one of: a, b)"


def test_a_series_counts_what_is_missing_and_says_what_it_is() -> None:
    gappy = Series(np.array([1.0, np.nan, np.inf, 4.0]), 10.0, name="gyro_x", gaps=True)
    assert gappy.missing == 2
    assert repr(gappy) == "Series gyro_x: 4 samples at 10 Hz, unit unknown"
    with pytest.raises(InputError, match="gyro_x: 2 of 4 samples are missing, and burg needs all of them"):
        gappy.complete("burg")
    whole = Series(np.arange(4.0), 10.0, "rad/s")
    assert whole.missing == 0
    assert whole.complete("burg") is whole
    for rate in (np.nan, np.inf, -1.0):
        with pytest.raises(InputError, match="expected a positive number"):
            Series(np.arange(4.0), rate)
    with pytest.raises(InputError, match=r"2 value\(s\) that are not finite, the first at row 1"):
        Series(np.array([1.0, np.inf, -np.inf]), 1.0)


def test_shapes_are_told_as_they_are_wanted() -> None:
    with pytest.raises(InputError, match=r"signal has shape \(2, 2\), expected \(n,\)"):
        Series(np.zeros((2, 2)), 1.0)
    with pytest.raises(InputError, match=r"gyro has shape \(3, 3\), expected \(2, 3\)"):
        ImuRecord(np.array([0.0, 1.0]), np.zeros((3, 3)), np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"gyro has shape \(2, 4\), expected \(2, 3\)"):
        ImuRecord(np.array([0.0, 1.0]), np.zeros((2, 4)), np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"gyro has 2 value\(s\) that are not finite, the first at row 2"):
        ImuRecord(np.arange(3.0), np.array([[0.0, 0, 0], [1, 1, 1], [np.nan, 0, np.nan]]), np.zeros((3, 3)))
    with pytest.raises(InputError, match="temperature has shape"):
        ImuRecord(np.arange(2.0), np.zeros((2, 3)), np.zeros((2, 3)), temperature=np.zeros(3))
    with pytest.raises(InputError, match=r"1 sample\(s\), expected at least two"):
        ImuRecord(np.array([0.0]), np.zeros((1, 3)), np.zeros((1, 3)))
    text = repr(ImuRecord(np.array([0.0, 0.5]), np.zeros((2, 3)), np.zeros((2, 3)), "mean"))
    assert text == "ImuRecord: 2 mean rows from 0 to 0.5 s"


def test_times_may_be_far_and_one_step_short() -> None:
    zero = np.zeros((2, 3))
    for t in ([-1e24, 0.0], [0.0, 1e24]):
        assert len(ImuRecord(np.array(t), zero, zero)) == 2
    for t in ([-1.1e24, 0.0], [0.0, 1.1e24]):
        with pytest.raises(InputError, match="expected times within"):
            ImuRecord(np.array(t), zero, zero)
    assert len(ImuRecord(np.array([0.0, 1e-12]), zero, zero)) == 2
    with pytest.raises(InputError, match="has steps of 9e-13 s"):
        ImuRecord(np.array([0.0, 9e-13]), zero, zero)
    # a single short step among usual ones is a stamp, not a rate
    assert len(ImuRecord(np.array([0.0, 5e-13, 1.0, 2.0]), np.zeros((4, 3)), np.zeros((4, 3)))) == 4
    with pytest.raises(InputError, match=r"repeats at row 2 \(.*1.0.* then .*1.0"):
        ImuRecord(np.array([0.0, 1.0, 1.0]), np.zeros((3, 3)), np.zeros((3, 3)))


def test_a_record_of_two_rows_becomes_increments() -> None:
    two = ImuRecord(
        np.array([0.0, 0.5]), np.array([[2.0, 0, 0], [4.0, 0, 0]]), np.zeros((2, 3)), "mean"
    ).as_increments()
    assert two.gyro[:, 0].tolist() == [2.0, 2.0]
    assert two.kind == "increment"


def test_widths_follow_stamps_that_are_more_than_jitter() -> None:
    t = np.array([0.0, 0.1, 0.201, 0.3, 0.5])
    imu = ImuRecord(t, np.ones((5, 3)), 2 * np.ones((5, 3)), "increment")
    np.testing.assert_allclose(imu.widths()[:, 0], [0.1, 0.1, 0.1, 0.1, 0.2], rtol=0.0, atol=1.1e-3)
    assert np.unique(imu.widths()[:4]).size == 1  # jitter of one per cent is of the stamps
    np.testing.assert_allclose(imu.widths(0.0)[:, 0], [0.1, 0.1, 0.101, 0.099, 0.2])
    np.testing.assert_allclose(imu.rates(), np.hstack([imu.gyro, imu.accel]) / imu.widths())
    again = imu.with_rates(3.0 * imu.rates())
    np.testing.assert_allclose(again.gyro, 3.0 * imu.gyro)
    np.testing.assert_allclose(again.accel, 3.0 * imu.accel)
    mean = ImuRecord(t, np.ones((5, 3)), 2 * np.ones((5, 3)), "mean")
    assert mean.widths().tolist() == [[1.0]] * 5
    assert mean.rates()[0].tolist() == [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]
    assert mean.dt == pytest.approx(0.1, rel=2e-4)  # five samples, one of them lost
    assert mean.gaps(0.15) == [(pytest.approx(0.3), pytest.approx(0.2))]
    # a step at the edge of jitter counts as one
    edge = ImuRecord(np.array([0.0, 1.0, 2.0, 3.02, 4.02]), np.ones((5, 3)), np.ones((5, 3)), "increment")
    assert np.unique(edge.widths(0.03)).size == 1
    assert edge.widths(0.01)[3, 0] == pytest.approx(1.02)


def test_rows_keep_all_columns() -> None:
    imu = ImuRecord(np.arange(4.0), np.arange(12.0).reshape(4, 3), np.ones((4, 3)), "mean", np.arange(4.0))
    some = imu.rows(slice(1, 3))
    assert (some.t.tolist(), some.temperature.tolist(), some.kind) == ([1.0, 2.0], [1.0, 2.0], "mean")  # type: ignore[union-attr]
    assert some.gyro[0].tolist() == [3.0, 4.0, 5.0]
    assert ImuRecord(np.arange(4.0), np.ones((4, 3)), np.ones((4, 3))).rows(slice(0, 2)).temperature is None


def test_sigmas_are_put_where_a_fix_states_none() -> None:
    t, llh = np.array([0.0, 1.0]), np.array([[0.8, 0.1, 10.0]] * 2)
    bare = GnssRecord(t, llh, np.ones((2, 3)))
    both = bare.with_sigma(2.0, [0.1, 0.2, 0.3])
    assert both.pos_std_ned.tolist() == [[2.0] * 3] * 2  # type: ignore[union-attr]
    assert both.vel_std_ned.tolist() == [[0.1, 0.2, 0.3]] * 2  # type: ignore[union-attr]
    assert bare.with_sigma(None, 0.1).pos_std_ned is None
    assert bare.with_sigma(2.0, None).vel_std_ned is None
    again = both.with_sigma(9.0, 9.0)  # what is stated stays
    assert again.pos_std_ned.tolist() == [[2.0] * 3] * 2  # type: ignore[union-attr]
    assert again.vel_std_ned.tolist() == [[0.1, 0.2, 0.3]] * 2  # type: ignore[union-attr]
    alone = both.without_velocity()
    assert alone.vel_ned is None and alone.vel_std_ned is None and alone.pos_std_ned is not None
    assert alone.with_sigma(1.0, 0.1).vel_std_ned is None


def test_a_latitude_is_told_with_its_row() -> None:
    pole = np.array([[np.pi / 2, 0.0, 0.0], [-np.pi / 2, 0.0, 0.0], [np.nan] * 3])
    assert len(GnssRecord(np.arange(3.0), pole)) == 3
    pole[1, 0] = -1.6
    with pytest.raises(InputError, match=r"gnss_llh row 1 has a latitude of -1\.6 rad \(-91\.\d+ deg\)"):
        GnssRecord(np.arange(3.0), pole)
    with pytest.raises(InputError, match=r"gnss_vel_ned has shape \(2, 3\), expected \(3, 3\)"):
        GnssRecord(np.arange(3.0), np.zeros((3, 3)), np.zeros((2, 3)))


def test_velocities_at_other_times_stand_in_rows_of_their_own() -> None:
    llh = np.array([[0.1, 0.2, 3.0], [0.2, 0.3, 4.0], [np.nan] * 3])
    speed = np.array([[1.0, 2, 3], [4.0, 5, 6], [7.0, 8, 9]])
    gnss = GnssRecord(np.array([0.0, 1.0, 2.0]), llh, speed, np.full((3, 3), 2.0), np.full((3, 3), 0.1))
    moved = gnss.with_velocities_at([0.1, 1.0 + 1e-9, 2.1])
    np.testing.assert_allclose(moved.t, [0.0, 0.1, 1.0, 2.1], atol=1e-8)
    assert np.isfinite(moved.llh[:, 0]).tolist() == [True, False, True, False]
    assert np.isfinite(moved.vel_ned[:, 0]).tolist() == [False, True, True, True]  # type: ignore[index]
    assert moved.vel_ned[3].tolist() == [7.0, 8.0, 9.0]  # type: ignore[index]
    assert moved.pos_std_ned[2].tolist() == [2.0] * 3  # type: ignore[index]
    assert moved.vel_std_ned[1].tolist() == [0.1] * 3  # type: ignore[index]
    assert moved.t[2] == 1.0  # the fix's own time
    bare = GnssRecord(np.array([0.0, 1.0]), llh[:2]).with_velocities_at([0.1, 1.1])
    assert (bare.t.tolist(), bare.vel_ned) == ([0.0, 1.0], None)


def test_an_initial_state_and_an_aid_are_checked() -> None:
    place = (np.zeros(3), np.zeros(3), np.zeros(3))
    assert InitialState(0.0, *place, np.zeros(9)).sigma.tolist() == [0.0] * 9
    with pytest.raises(InputError, match="time of the initial state is nan"):
        InitialState(np.nan, *place, np.zeros(9))
    with pytest.raises(InputError, match="expected nine numbers that are not negative"):
        InitialState(0.0, *place, np.array([1.0] * 8 + [-1e-9]))
    for k, (name, size) in enumerate((("llh", 3), ("vel_ned", 3), ("rpy", 3), ("sigma", 9))):
        parts = [*place, np.zeros(9)]
        parts[k] = np.zeros(size + 1)
        with pytest.raises(InputError, match=f"initial {name} has shape"):
            InitialState(0.0, *parts)
    t, one = np.array([0.0, 1.0]), np.ones((2, 1))
    aid = AidRecord("odometer", t, one, one, since=t - 1.0)
    assert len(aid) == 2 and repr(aid) == "AidRecord: 2 odometer rows from 0 to 1 s"
    with pytest.raises(InputError, match=r"odometer std has shape \(2, 2\), expected \(2, 1\)"):
        AidRecord("odometer", t, one, np.ones((2, 2)))
    with pytest.raises(InputError, match="odometer since has shape"):
        AidRecord("odometer", t, one, one, since=np.zeros(3))
    assert AidRecord("odometer", t, np.full((2, 1), np.nan), one).since is None
