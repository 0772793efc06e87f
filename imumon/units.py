"""Units at the boundary: from what a device or a table has to what imumon has inside."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from tokenize import TokenError
from typing import Any

from imumon.errors import ImumonError, Reason

# What the field writes and pint reads otherwise or not at all.
_SPELLINGS = {
    "dps": "deg/s",
    "mdps": "millideg/s",
    "deg/h": "deg/hour",
    "°/s": "deg/s",
    "°/h": "deg/hour",
    "°": "deg",
    "g": "standard_gravity",
    "mg": "millistandard_gravity",
    "ug": "microstandard_gravity",
    "µg": "microstandard_gravity",
    "C": "degC",
    "°C": "degC",
    "F": "degF",
    "°F": "degF",
    "Gauss": "gauss",
    "G": "gauss",
    "mG": "milligauss",
    "mgauss": "milligauss",
}
"""In this field "g" is never a gram and "C" never a coulomb."""

# pint knows a gauss of the cgs system, which is not a tesla's kind.
_ADDED = ["flux_gauss = 1e-4 * tesla"]


_PI = Fraction("3.1415926535897932384626433832795028841971693993751")
_COMMON = {
    ("deg/s", "rad/s"): _PI / 180,
    ("deg", "rad"): _PI / 180,
    ("g", "m/s^2"): Fraction("9.80665"),
    ("mg", "m/s^2"): Fraction("0.00980665"),
    ("gauss", "uT"): Fraction(100),
    ("s", "ns"): Fraction(1_000_000_000),
    ("ms", "ns"): Fraction(1_000_000),
    ("us", "ns"): Fraction(1000),
}
"""What nearly every device file needs, for a start without pint, which takes half a second.  The tests
compare with pint."""
LONGEST = 40
"""No unit is written with more characters."""


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint

    # In fractions, so that a microsecond is exactly 1000 ns; rounded to float64 once, at the end.
    registry: Any = pint.UnitRegistry(non_int_type=Fraction)
    for definition in _ADDED:
        registry.define(definition)
    return registry


def conversion(unit: str, target: str) -> tuple[float, float]:
    """Return (factor, offset) so that value_in_target = factor * value_in_unit + offset.

    Raises
    ------
    ImumonError
        BAD_CONFIG when the unit is unknown or measures something else than the target.
    """
    factor, offset = exact_conversion(unit, target)
    return float(factor), float(offset)


@lru_cache(maxsize=256)
def exact_conversion(unit: str, target: str) -> tuple[Fraction, Fraction]:
    """Return `conversion` as fractions, not yet rounded."""
    if unit == target:
        return Fraction(1), Fraction(0)
    if (unit, target) in _COMMON:
        return _COMMON[unit, target], Fraction(0)
    return _by_pint(unit, target)


def _by_pint(unit: str, target: str) -> tuple[Fraction, Fraction]:
    import pint

    if len(unit) > LONGEST or unit.count("**") > 1:  # pint computes powers, however large
        raise ImumonError(
            Reason.BAD_CONFIG, f"unit {unit[:LONGEST]!r} is not known", f"expected one like {target!r}"
        )
    registry = _registry()
    try:
        source = registry.Unit(_spelled(unit))
        at_zero, at_one = (
            Fraction(registry.Quantity(Fraction(value), source).to(_spelled(target)).magnitude)
            for value in (0, 1)
        )
    except pint.DimensionalityError as error:
        raise ImumonError(
            Reason.BAD_CONFIG, f"unit {unit!r} does not measure what {target!r} measures", "check the unit"
        ) from error
    except (
        pint.PintError,
        TokenError,
        SyntaxError,
        ArithmeticError,
        ValueError,
        TypeError,
        AttributeError,
        AssertionError,
    ) as error:  # all of which pint raises on malformed text
        raise ImumonError(
            Reason.BAD_CONFIG, f"unit {unit!r} is not known", f"expected one like {target!r}"
        ) from error
    return at_one - at_zero, at_zero


def _spelled(unit: str) -> str:
    spelled = _SPELLINGS.get(unit.strip(), unit.strip())
    return spelled.replace("gauss", "flux_gauss")
