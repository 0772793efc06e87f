"""Units at the boundary: from what a device or a table has to what imumon has inside."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from tokenize import TokenError
from typing import Any

from imumon.blocks import FloatArray
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
EXAMPLES = {
    "rad/s": "rad/s, deg/s, dps, mdps, deg/h, rpm",
    "m/s^2": "m/s^2, g, mg",
    "uT": "uT, nT, gauss, mgauss",
    "degC": "degC, degF, K",
    "rad": "rad, deg",
    "Pa": "Pa, hPa, kPa, mbar",
    "ns": "s, ms, us, ns",
    "1": "1",
}
"""Units that are common for each unit that imumon uses."""

LONGEST = 40
"""No unit is written with more characters."""
_SCALED = re.compile(r"(?P<unit>.*\S)\s*/\s*(?P<count>\d+(?:\.\d+)?)", re.ASCII)
_BIG_POWER = re.compile(r"[\d)]\s*(\*\*|\^)|(\*\*|\^)(?!\s*[+-]?\d(?!\d))|\d[eE][+-]?\d\d")
"""A power of a number or of a bracket, by anything but one digit, or of ten by two: no unit has it, and pint
would compute 9**9**9**9."""


_MALFORMED = (
    TokenError, SyntaxError, ArithmeticError, ValueError, TypeError, KeyError, AttributeError, AssertionError,
)  # fmt: skip
"""What pint raises on malformed text besides its own errors."""


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint

    # In fractions, so that a microsecond is exactly 1000 ns; rounded to float64 once, at the end.
    registry: Any = pint.UnitRegistry(non_int_type=Fraction)
    registry.define("flux_gauss = 1e-4 * tesla")  # pint's is of the cgs system, not of a tesla's kind
    return registry


@lru_cache(maxsize=256)
def exact_conversion(unit: str, target: str) -> tuple[Fraction, Fraction]:
    """Return (factor, offset), not rounded, so that value_in_target = factor * value_in_unit + offset.

    Raises BAD_CONFIG when the unit is unknown or measures something else than the target.
    """
    if unit == target:
        return Fraction(1), Fraction(0)
    if (unit, target) in _COMMON:
        return _COMMON[unit, target], Fraction(0)
    return _by_pint(unit, target)


def _by_pint(unit: str, target: str) -> tuple[Fraction, Fraction]:
    import pint

    unknown = ImumonError(
        Reason.BAD_CONFIG, f"unit {unit[:LONGEST]!r} is not known", f"expected one like {target!r}"
    )
    if len(unit) > LONGEST or _BIG_POWER.search(unit):
        raise unknown
    registry = _registry()
    try:
        source = registry.Unit(_spelled(unit))
        # To pint radians and counts are plain numbers, and a Hz would be a rad/s.
        ours = registry.get_root_units(registry.Unit(_spelled(target)))[1]
        if registry.get_root_units(source)[1] != ours:
            raise _of_another_kind(unit, target)
        at_zero, at_one = (
            Fraction(registry.Quantity(Fraction(value), source).to(_spelled(target)).magnitude)
            for value in (0, 1)
        )
    except pint.DimensionalityError as error:
        raise _of_another_kind(unit, target) from error
    except (pint.PintError, *_MALFORMED) as error:
        raise unknown from error
    return at_one - at_zero, at_zero


def _of_another_kind(unit: str, target: str) -> ImumonError:
    what = f"unit {unit!r} does not measure what {target!r} measures"
    return ImumonError(Reason.BAD_CONFIG, what, f"expected one like {EXAMPLES.get(target, target)}")


def _spelled(unit: str) -> str:
    spelled = _SPELLINGS.get(unit.strip(), unit.strip())
    return spelled.replace("gauss", "flux_gauss")


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of a table: value in `target` = factor * value + offset."""

    text: str
    target: str
    factor: Fraction
    offset: Fraction

    def convert(self, values: FloatArray) -> FloatArray:
        """Return values in this unit in the target unit; unchanged to the bit when the units are the same."""
        if self.factor == 1 and self.offset == 0:
            return values
        return values * float(self.factor) + float(self.offset)


def parse_unit(text: str, target: str) -> Unit:
    """Parse a unit and check that it measures the same as `target`.

    A number that it is divided by is a scale: in "g/16384" a g has 16384 counts.

    Raises ValueError when it is unknown, not a unit, or of another kind.
    """
    usual = f"usual here: {EXAMPLES.get(target, target)}"
    if len(text) > 2 * LONGEST:
        raise ValueError(f"{text[:LONGEST]!r}... is not known; {usual}")
    scaled = _SCALED.fullmatch(text)
    bare, count = (scaled["unit"], Fraction(scaled["count"])) if scaled else (text, Fraction(1))
    if not count:
        raise ValueError(f"{text!r} is not a unit; {usual}")
    try:
        factor, offset = exact_conversion(bare, target)
    except ImumonError as error:
        raise ValueError(f"{error.seen}; {usual}") from error
    return Unit(text, target, factor / count, offset)


def parse_own_unit(text: str) -> Unit:
    """Parse a unit that is kept, whatever it measures; of raw counts, the one that is divided.

    Raises ValueError when it is unknown, or not a unit.
    """
    scaled = _SCALED.fullmatch(text)
    bare = scaled["unit"] if scaled else text
    try:
        _by_pint(bare, bare)
    except ImumonError as error:
        raise ValueError(f"{error.seen}; usual here: V, A, rpm, degC, 1") from error
    return parse_unit(text, bare)
