from __future__ import annotations

import math
from fractions import Fraction

import pytest

from imumon.errors import ImumonError
from imumon.units import _COMMON, _by_pint, conversion


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
    got_factor, got_offset = conversion(unit, target)
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
        ("9**9**9**9", "not known"),
        ("degC", "does not measure"),
    ],
)
def test_a_wrong_unit_is_refused(unit: str, words: str) -> None:
    with pytest.raises(ImumonError, match=words):
        conversion(unit, "rad/s")


def test_the_common_factors_are_those_of_pint() -> None:
    for (unit, target), factor in _COMMON.items():
        assert _by_pint(unit, target) == (factor, Fraction(0)), unit
