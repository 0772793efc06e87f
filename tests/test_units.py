from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from imumon.units import exact_conversion, parse_own_unit, parse_unit

DEG = math.pi / 180


@pytest.mark.parametrize(
    ("unit", "target", "factor", "offset"),
    [
        ("rad/s", "rad/s", 1.0, 0.0),
        ("deg/s", "rad/s", math.pi / 180, 0.0),
        ("dps", "rad/s", math.pi / 180, 0.0),
        ("mdps", "rad/s", math.pi / 180_000, 0.0),
        ("deg/h", "rad/s", math.pi / 648_000, 0.0),
        ("g", "m/s^2", 9.80665, 0.0),
        ("mg", "m/s^2", 9.80665e-3, 0.0),
        ("gauss", "uT", 100.0, 0.0),
        ("mgauss", "uT", 0.1, 0.0),
        ("nT", "uT", 1e-3, 0.0),
        ("us", "ns", 1000.0, 0.0),
        ("ms", "ns", 1e6, 0.0),
        ("K", "degC", 1.0, -273.15),
        ("°C", "degC", 1.0, 0.0),
        ("degF", "degC", 5 / 9, -160 / 9),
        ("mbar", "Pa", 100.0, 0.0),
        ("hPa", "Pa", 100.0, 0.0),
    ],
)
def test_factors_and_offsets(unit: str, target: str, factor: float, offset: float) -> None:
    got_factor, got_offset = map(float, exact_conversion(unit, target))
    assert got_factor == pytest.approx(factor, rel=2.3e-16)
    assert got_offset == pytest.approx(offset, rel=2.3e-16)


@pytest.mark.parametrize(
    ("unit", "words"),
    [
        ("m", "does not measure"),
        ("quux", "not known"),
        ("deg/", "not known"),
        ("rad/s)", "not known"),
        ("1/0", "not known"),
        ("a^0", "not known"),
        ("9**9**9**9", "not known"),
        ("degC", "does not measure"),
    ],
)
def test_a_wrong_unit_is_refused(unit: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        exact_conversion(unit, "rad/s")


@pytest.mark.parametrize(
    "text", ["V", "mA", "rpm", "degC/s", "°C/min", "%", "kohm", "N*m", "hPa", "V/1024", "mg/s"]
)
def test_a_unit_of_one_s_own_is_kept(text: str) -> None:
    unit = parse_own_unit(text)
    assert unit.offset == 0
    assert unit.factor == (Fraction(1, 1024) if "1024" in text else 1)


@pytest.mark.parametrize("text", ["wibbles", "", "V/0", "2*V", "m^12"])
def test_what_is_no_unit_at_all_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"is not (known|a unit)"):
        parse_own_unit(text)


@pytest.mark.parametrize(
    ("text", "target", "value", "expected"),
    [
        ("°/s", "rad/s", 180.0, math.pi),
        ("dps", "rad/s", 180.0, math.pi),
        ("dps/16.4", "rad/s", 16.4, DEG),
        ("ug", "m/s^2", 1e6, 9.80665),
        ("µg", "m/s^2", 1e6, 9.80665),
        ("g/16384", "m/s^2", 16384.0, 9.80665),
        ("m/s²", "m/s^2", 2.0, 2.0),
        ("m/s**2", "m/s^2", 2.0, 2.0),
        ("cm/s^2", "m/s^2", 200.0, 2.0),
        ("uT", "uT", 50.0, 50.0),
        ("µT", "uT", 50.0, 50.0),
        ("T", "uT", 50e-6, 50.0),
        ("G", "uT", 0.5, 50.0),
        ("mG", "uT", 500.0, 50.0),
        ("degC", "degC", 25.5, 25.5),
        ("degF", "degC", 212.0, 100.0),
        ("K", "degC", 273.15, 0.0),
        ("degC/256", "degC", 256.0, 1.0),
        ("degF/10", "degC", 2120.0, 100.0),
        ("deg", "rad", 180.0, math.pi),
        ("1", "1", 0.5, 0.5),
    ],
)
def test_units_of_inertial_sensors(text: str, target: str, value: float, expected: float) -> None:
    converted = parse_unit(text, target).convert(np.array([value, np.nan]))
    assert converted[0] == pytest.approx(expected, rel=1e-14, abs=1e-9)
    assert np.isnan(converted[1])


@pytest.mark.parametrize(("text", "target"), [("rad/s", "rad/s"), ("m/s^2", "m/s^2"), ("degC", "degC")])
def test_values_in_the_right_unit_are_not_touched(text: str, target: str) -> None:
    values = np.random.default_rng(1).normal(size=1000)
    assert parse_unit(text, target).convert(values).tobytes() == values.tobytes()


@pytest.mark.parametrize(
    ("text", "target", "message"),
    [
        (
            "inch/s",
            "rad/s",
            "'inch/s' does not measure what 'rad/s' measures; usual here: rad/s, deg/s",
        ),
        ("xyzzy", "rad/s", "'xyzzy' is not known"),
        ("kg", "m/s^2", "does not measure what"),
        (
            "Hz",
            "rad/s",
            "does not measure what 'rad/s' measures; usual here: rad/s, deg/s, dps, mdps, deg/h, rpm",
        ),
        ("1/s", "rad/s", "does not measure what"),
        ("counts/s", "rad/s", "does not measure what"),
        ("1", "rad", "does not measure what"),
        ("rad", "1", "does not measure what"),
        ("rad m/s^2", "m/s^2", "does not measure what"),
        ("Hz m", "m/s^2", "does not measure what"),
        ("rad uT", "uT", "does not measure what"),
        ("kg", "g", "does not measure what"),
        ("degC/s", "degC", "does not measure what"),
        ("V", "degC", "does not measure what 'degC' measures; usual here: degC, degF, K"),
        ("rad/s/", "rad/s", "is not known"),
        ("1/0", "rad/s", "is not a unit"),
        ("0*rad/s", "rad/s", "is not known"),
        ("rad/s)", "rad/s", "is not known"),
        ("rad/s/0", "rad/s", "is not a unit"),
        ("2**9**9**9", "rad/s", "is not known"),
        ("rad/s" * 20, "rad/s", "is not known"),
        ("import os", "rad/s", "is not known"),
    ],
)
def test_what_is_no_unit_here_is_refused_with_what_is(text: str, target: str, message: str) -> None:
    with pytest.raises(ValueError, match=message.replace("^", r"\^")):
        parse_unit(text, target)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("s", 10**9),
        ("ms", 10**6),
        ("us", 1000),
        ("µs", 1000),
        ("ns", 1),
        ("min", 60 * 10**9),
        ("s/32768", Fraction(10**9, 32768)),
    ],
)
def test_units_of_time_are_exact(text: str, expected: Fraction) -> None:
    unit = parse_unit(text, "ns")
    assert unit.factor == expected
    assert unit.offset == 0
