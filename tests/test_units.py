"""Datasheet units at the door."""

from __future__ import annotations

import contextlib
import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from insemu import units
from insemu.errors import InputError


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("0.032 deg/s/sqrt(Hz)", "rad/s/sqrt(Hz)", math.radians(0.032)),
        ("2.42 deg/sqrt(h)", "rad/s/sqrt(Hz)", math.radians(2.42) / 60),
        ("85.5 ug/sqrt(Hz)", "m/s^2/sqrt(Hz)", 85.5e-6 * 9.80665),
        ("0.045 m/s/sqrt(h)", "m/s^2/sqrt(Hz)", 0.045 / 60),
        ("168.6 m/s/h^1.5", "m/s^2*sqrt(Hz)", 168.6 / 3600**1.5),
        ("0.024 Hz", "1/s", 0.024),
        ("7 min", "s", 420.0),
        ("1 µg", "m/s^2", 9.80665e-6),
        ("40 deg/h/K", "rad/s/K", math.radians(40) / 3600),
        ("1400 ppm", "", 1.4e-3),
        ("-2.5e-3 m/s", "m/s", -2.5e-3),
        ("3 (m/s^2)^2/Hz", "(m/s^2)^2/Hz", 3.0),
        ("4 m^(1/2)", "m^(1/2)", 4.0),
        (5, "m", 5.0),
        ("5", "m", 5.0),
    ],
)
def test_quantities(text: str | int, unit: str, expected: float) -> None:
    assert units.parse(text, unit) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 m", "another dimension"),
        ("1 degs", "did you mean 'deg'"),
        ("one deg", "cannot read"),
        ("1 deg/(s", "expected \\)"),
        ("1 deg)", "cannot read the unit"),
        ("1 deg/", "found the end"),
        ("1 rad^x", "exponent"),
        ("1 rad$", "cannot read the unit"),
        ("1e999 rad", "finite"),
        (True, "found True"),
    ],
)
def test_what_cannot_be_read_is_said(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        units.parse(text, "rad")


@given(st.floats(-1e6, 1e6), st.sampled_from(list(units.DATASHEET)))
def test_datasheet_values_are_read_back(value: float, unit: str) -> None:
    shown, shown_unit = units.datasheet(value, unit)
    assert units.parse(f"{shown!r} {shown_unit}", unit) == pytest.approx(value, rel=1e-12, abs=1e-300)


def test_a_unit_that_no_datasheet_uses_stays() -> None:
    assert units.datasheet(3.0, "1/s") == (3.0, "1/s")


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("dps", "deg/s"), ("mdps", "0.001 deg/s"), ("°/h", "deg/h"), ("deg/√h", "deg/sqrt(h)"), ("ug/√Hz", "ug/sqrt(Hz)"),
        ("ug/rtHz", "ug/sqrt(Hz)"), ("m/s²", "m/s^2"), ("m/s2", "m/s^2"), ("rad s^-1", "rad/s"), ("m s⁻²", "m/s^2"),
        ("ns", "1e-9 s"), ("µs", "us"), ("mph", "0.44704 m/s"), ("knots", "kn"), ("0.05 deg/s/LSB", "0.05 deg/s"),
    ],
)  # fmt: skip
def test_units_as_people_write_them(text: str, plain: str) -> None:
    one, two = units.scaled_unit(text), units.scaled_unit(plain)
    assert one.dimension == two.dimension
    assert one.factor == pytest.approx(two.factor, rel=1e-14)


@pytest.mark.parametrize(
    "found",
    [{}, {"a": 1}, [1], None, 10**400, "1" * 5000, "1 m^(1/0)", "1 m^1e9", "1 m^999999999", "1 " + "(" * 150 + "m",
     "1 (((km^24)^24)^24)^24", "1 \ud800", "1 " + "sqrt(" * 30 + "m", b"1 m", "1 m" + " " * 10**6 + "x"],
)  # fmt: skip
def test_hostile_quantities_are_refused_at_once(found: object) -> None:
    began = time.process_time()
    with pytest.raises(InputError):
        units.parse(found, "m")  # type: ignore[arg-type]
    assert time.process_time() - began < 0.5


@given(st.text(alphabet="0123456789.eE+-*/^() mskgdegHzradsqrt√°µ²⁻\t\ud800", max_size=60))
def test_any_text_is_a_unit_or_an_input_error(text: str) -> None:
    for read in (units.parse_unit, units.scaled_unit, lambda t: units.parse(t, "m/s")):
        with contextlib.suppress(InputError):
            read(text)
