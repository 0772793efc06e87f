"""Units of foreign tables: checked against what a column measures, with a scale for raw counts."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction

from imumon.blocks import FloatArray
from imumon.errors import ImumonError
from imumon.units import exact_conversion

EXAMPLES = {
    "rad/s": "rad/s, deg/s, dps, mdps, deg/h",
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
_SCALED = re.compile(r"(?P<unit>.*\S)\s*/\s*(?P<count>\d+(?:\.\d+)?)", re.ASCII)
_POWER_OF_NUMBER = re.compile(r"\d\s*(\*\*|\^)")
"""No unit has it, and pint would compute 9**9**9**9."""


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
    """Parse a unit and check that it measures the same as `target`, a key of `EXAMPLES`.

    A number that it is divided by is a scale: in "g/16384" a g has 16384 counts.

    Raises
    ------
    ValueError
        When it is unknown, not a unit, or of another kind.
    """
    usual = f"usual here: {EXAMPLES[target]}"
    scaled = _SCALED.fullmatch(text)
    bare, count = (scaled["unit"], Fraction(scaled["count"])) if scaled else (text, Fraction(1))
    if len(text) > LONGEST or _POWER_OF_NUMBER.search(text) or not count:
        raise ValueError(f"{text[:LONGEST]!r} is not a unit; {usual}")
    try:
        factor, offset = exact_conversion(bare, target)
    except ImumonError as error:
        raise ValueError(f"{error.seen}; {usual}") from error
    return Unit(text, target, factor / count, offset)
