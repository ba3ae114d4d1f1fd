"""Typed records check what comes in."""

from __future__ import annotations

import numpy as np
import pytest

from insemu.errors import InputError, nearest
from insemu.records import GnssRecord, ImuRecord, Series, Trajectory


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
    with pytest.raises(InputError, match="latitude of 2578"):
        GnssRecord(np.array([0.0]), np.array([[45.0, 9.0, 100.0]]))
    with pytest.raises(InputError, match="not finite"):
        Trajectory(np.array([0.0, 1.0]), llh, np.zeros((2, 3)), np.zeros((2, 3)))


def test_hints() -> None:
    assert nearest("lenght", ["length", "rate"]) == " (did you mean 'length'?)"
    assert nearest("zzz", ["b", "a"]) == " (expected one of: a, b)"
