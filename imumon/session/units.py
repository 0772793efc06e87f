"""Units of foreign tables, by pint, with the abbreviations that inertial sensors are sold with."""

from __future__ import annotations

import re
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pint

from imumon.blocks import FloatArray

EXAMPLES = {
    "rad/s": "rad/s, deg/s, dps, mdps, deg/h",
    "m/s^2": "m/s^2, g, mg",
    "uT": "uT, nT, gauss, mgauss",
    "degC": "degC, degF, K",
    "rad": "rad, deg",
    "Pa": "Pa, hPa, kPa, mbar",
    "s": "s, ms, us, ns",
    "1": "1",
}
"""Units that are common for each unit that imumon uses."""

_SYMBOLS = {
    "m/s^2": re.compile(r"(?<![A-Za-z_])(?P<prefix>[mµμu]?)[gG](?![A-Za-z_0-9])"),
    "uT": re.compile(r"(?<![A-Za-z_])(?P<prefix>[mµμu]?)(?:gauss|G)(?![A-Za-z_0-9])"),
}
"""Symbols that mean something else to pint: g is gram there, and gauss belongs to another system of units."""

_OWN = {"m/s^2": "standard_gee", "uT": "si_gauss"}

_LONGEST = 40


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of a table that was checked to fit the unit that imumon uses for the quantity."""

    text: str
    target: str
    factor: float
    units: Any

    def convert(self, values: FloatArray) -> FloatArray:
        """Return values in this unit in the target unit; unchanged to the bit when the units are the same."""
        scaled = values if self.factor == 1.0 else values * self.factor
        quantity = _registry().Quantity(scaled, self.units)
        return np.asarray(quantity.to(_target(self.target)).magnitude, np.float64)


def parse_unit(text: str, target: str) -> Unit:
    """Parse a unit and check that it measures the same as `target`, a key of `EXAMPLES`.

    A number in it is a scale: "g/16384" is the unit of raw counts of an accelerometer.

    Raises
    ------
    ValueError
        When it is unknown, not a unit, or of another kind.
    """
    usual = f"usual here: {EXAMPLES[target]}"
    if len(text) > _LONGEST or re.search(r"\d\s*(\*\*|\^)", text):
        raise ValueError(f"{text[:_LONGEST]!r} is not a unit; {usual}")
    own = _OWN.get(target)
    pattern = _SYMBOLS.get(target)
    spelled = pattern.sub(rf"\g<prefix>{own}", text) if pattern else text
    try:
        parsed = _registry().parse_expression(spelled)
        factor = float(getattr(parsed, "magnitude", parsed))
        units = getattr(parsed, "units", _registry().dimensionless)
        unit = Unit(text, target, factor, units)
        one = unit.convert(np.ones(1))
    except pint.UndefinedUnitError as error:
        raise ValueError(f"unit {text!r} is not known; {usual}") from error
    except pint.DimensionalityError as error:
        raise ValueError(f"unit {text!r} does not measure the same as {target}; {usual}") from error
    except (pint.PintError, ArithmeticError, TypeError, ValueError, AssertionError, SyntaxError) as error:
        # The parser of pint lets all of these through when the text is not an expression.
        raise ValueError(f"{text!r} is not a unit; {usual}") from error
    if not np.isfinite(one[0]) or factor == 0.0:
        raise ValueError(f"{text!r} is not a unit; {usual}")
    return unit


def nanoseconds_per(text: str) -> Decimal:
    """Return a unit of time in nanoseconds, exact to 28 digits.

    Raises
    ------
    ValueError
        When it is not a unit of time.
    """
    seconds = Fraction(float(parse_unit(text, "s").convert(np.ones(1))[0])).limit_denominator(10**12)
    if seconds <= 0:
        raise ValueError(f"{text!r} is not a unit of time; usual here: {EXAMPLES['s']}")
    return Decimal(seconds.numerator * 10**9) / Decimal(seconds.denominator)


@cache
def _registry() -> pint.UnitRegistry[Any]:
    registry: pint.UnitRegistry[Any] = pint.UnitRegistry()
    registry.define("degree_per_second = degree / second = dps")
    registry.define("standard_gee = 9.80665 * meter / second ** 2")
    registry.define("si_gauss = 1e-4 * tesla")
    return registry


@cache
def _target(text: str) -> pint.Unit:
    return _registry().Unit("" if text == "1" else text)
