"""Datasheet units at the door."""

from __future__ import annotations

import contextlib
import math
import time
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import constants

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


#: What one of every unit is, and in which SI unit: after SciPy's table of CODATA and the definitions of the foot, mile and knot.
SIZES = {
    "rad": (1.0, "rad"), "mrad": (1e-3, "rad"), "urad": (1e-6, "rad"), "deg": (constants.degree, "rad"), "°": (constants.degree, "rad"),
    "arcmin": (constants.arcmin, "rad"), "arcsec": (constants.arcsec, "rad"), "m": (1.0, "m"), "mm": (1e-3, "m"), "cm": (1e-2, "m"),
    "km": (1e3, "m"), "ft": (constants.foot, "m"), "s": (1.0, "s"), "sec": (1.0, "s"), "ms": (1e-3, "s"), "us": (1e-6, "s"),
    "ns": (1e-9, "s"), "min": (constants.minute, "s"), "h": (constants.hour, "s"), "hr": (constants.hour, "s"),
    "day": (constants.day, "s"), "Hz": (1.0, "1/s"),
    "kHz": (1e3, "1/s"), "g": (constants.g, "m/s^2"), "mg": (1e-3 * constants.g, "m/s^2"), "ug": (1e-6 * constants.g, "m/s^2"),
    "Gal": (1e-2, "m/s^2"), "mGal": (1e-5, "m/s^2"), "rev": (2.0 * math.pi, "rad"),
    "kn": (constants.knot, "m/s"), "mph": (constants.mph, "m/s"), "kph": (constants.kmh, "m/s"),
    "dps": (constants.degree, "rad/s"), "mdps": (1e-3 * constants.degree, "rad/s"), "dph": (constants.degree / 3600.0, "rad/s"),
    "rpm": (2.0 * math.pi / 60.0, "rad/s"), "K": (1.0, "K"), "degC": (1.0, "K"), "ppm": (1e-6, ""), "%": (1e-2, ""), "LSB": (1.0, ""),
    "1": (1.0, ""),
}  # fmt: skip


def test_every_unit_has_its_size_and_dimension() -> None:
    assert set(SIZES) == set(units._UNITS)
    for name, (size, si) in SIZES.items():
        unit = units.parse_unit(name)
        assert unit.factor == pytest.approx(size, rel=1e-14), name
        assert unit.dimension == units.parse_unit(si).dimension, name


def test_base_units_are_all_different_and_spellings_lead_to_units() -> None:
    base = [units.parse_unit(u).dimension for u in ("", "rad", "m", "s", "K")]
    assert len(set(base)) == 5 and base == [
        (0, 0, 0, 0), (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1),
    ]  # fmt: skip
    for spelling, name in units._SPELLINGS.items():
        assert units.parse_unit(spelling) == units.parse_unit(name)


@pytest.mark.parametrize(
    ("text", "factor", "dimension"),
    [
        ("deg/km/K*h", constants.degree / 1e3 * 3600.0, (1, -1, 1, -1)),
        ("(km deg K ms)^2", (1e3 * constants.degree * 1e-3) ** 2, (2, 2, 2, 2)),
        ("km^(-3/2) deg^(1/4) K^-3", 1e3**-1.5 * constants.degree**0.25, (Fraction(1, 4), Fraction(-3, 2), 0, -3)),
        ("km (ms)", 1.0, (0, 1, 1, 0)), ("km √ms", 1e3 * 1e-3**0.5, (0, 1, Fraction(1, 2), 0)),
        ("km °", 1e3 * constants.degree, (1, 1, 0, 0)), ("km %", 10.0, (0, 1, 0, 0)), ("km·ms", 1.0, (0, 1, 1, 0)),
        ("rtHz", 1.0, (0, 0, Fraction(-1, 2), 0)), ("km rootms", 1e3 * 1e-3**0.5, (0, 1, Fraction(1, 2), 0)),
        ("km**2", 1e6, (0, 2, 0, 0)), ("km2", 1e6, (0, 2, 0, 0)), ("km-2", 1e-6, (0, -2, 0, 0)), ("  km ", 1e3, (0, 1, 0, 0)),
    ],
)  # fmt: skip
def test_products_quotients_and_powers(text: str, factor: float, dimension: tuple[Fraction | int, ...]) -> None:
    unit = units.parse_unit(text)
    assert unit.dimension == dimension
    assert unit.factor == pytest.approx(factor, rel=1e-14)


def test_limits_are_where_they_are_said_to_be() -> None:
    """What is read at a limit is refused one beyond it, and the limits are what a person could still write."""
    assert (units.LONGEST, units.DEEPEST, units.HIGHEST) == (200, 16, 24)
    for good, bad in (
        ("m" + " " * 199, "m" + " " * 200),
        ("(" * 16 + "m" + ")" * 16, "(" * 17 + "m" + ")" * 17),
        ("m^24", "m^25"),
        ("m^-24", "m^-25"),
        ("(m)(m)(m)" * 6, "((" * 9 + "m"),
    ):
        units.parse_unit(good)
        with pytest.raises(InputError, match="cannot read"):
            units.parse_unit(bad)
    assert units.parse("1" + " " * 198 + "m", "m") == 1.0
    with pytest.raises(InputError, match="at most 200"):
        units.parse("1" + " " * 199 + "m", "m")


@pytest.mark.parametrize("text", ["km^24 km^24 km^24 km^24 km^24", "us^24 us^24 us^24 us^24 us^24", "0 m", "1e999 m"])
def test_a_size_that_is_no_number_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="its size is no number"):
        units.scaled_unit(text)


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
