"""Units at the boundary: from what a device or a table has to what imumon has inside."""

import re
from collections import Counter
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

from .blocks import FloatArray

_PI = Fraction("3.1415926535897932384626433832795028841971693993751")
_BASE = {"rad", "s", "m", "kg", "A", "K", "V", "N", "J", "W", "ohm", "Pa", "T", "Hz"}
"""Units that are not converted into each other.  An angle is one of them: a Hz is not a rad/s."""

_UNITS: dict[str, tuple[str | int | Fraction, str]] = {
    "1": (1, ""), "%": ("0.01", ""), "ppm": ("1e-6", ""),
    "deg": (_PI / 180, "rad"), "dps": (1, "deg/s"), "turn": (360, "deg"), "rpm": (6, "deg/s"),
    "min": (60, "s"), "h": (3600, "s"), "day": (86_400, "s"),
    "g": ("9.80665", "m/s^2"),  # in this field never a gram
    "gauss": ("1e-4", "T"), "bar": (100_000, "Pa"), "ft": ("0.3048", "m"), "inch": ("0.0254", "m"),
    "degC": (1, "K"), "degF": (Fraction(5, 9), "K"),
}  # fmt: skip
"""Each name: so many of others."""

_AT_ZERO = {"degC": Fraction("273.15"), "degF": Fraction("459.67") * 5 / 9}
"""The temperature at zero, in K, of scales that do not begin there."""

_PREFIXES = {"n": "1e-9", "u": "1e-6", "m": "1e-3", "c": "1e-2", "h": "100", "k": "1000", "M": "1e6"}

_SPELLINGS = {
    "G": "gauss", "mG": "mgauss", "Gauss": "gauss", "C": "degC", "F": "degF",  # C is never a coulomb here
    "sec": "s", "second": "s", "seconds": "s", "minute": "min", "minutes": "min", "hour": "h", "hours": "h",
    "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "count": "1", "counts": "1",
}  # fmt: skip
_SYMBOLS = {
    "°C": "degC", "°F": "degF", "°": "deg", "µ": "u", "μ": "u", "Ω": "ohm", "²": "^2", "³": "^3", "·": "*",
    "**": "^",
}  # fmt: skip

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
_COUNTED = re.compile(r"(?P<unit>.*\S)\s*/\s*(?P<count>\d+(?:\.\d+)?)", re.ASCII)
_TERM = re.compile(r"([A-Za-z]+|%|1)(?:\^(-?[1-9]))?", re.ASCII)
"""One factor of a product: its name and its power."""

Measure = tuple[Fraction, dict[str, int]]
"""How many of which product of base units: a factor, and the power of each base unit."""


@lru_cache(maxsize=256)
def exact_conversion(unit: str, target: str) -> tuple[Fraction, Fraction]:
    """Return (factor, offset), not rounded, so that value_in_target = factor * value_in_unit + offset.

    Raises ValueError when the unit is unknown or measures something else than the target.
    """
    given, wanted = _parsed(unit), _parsed(target)
    usual = f"usual here: {EXAMPLES.get(target, target)}"
    if given is None:
        raise ValueError(f"unit {unit[:LONGEST]!r} is not known; {usual}")
    if wanted is None or given[1] != wanted[1]:
        raise ValueError(f"unit {unit!r} does not measure what {target!r} measures; {usual}")
    return given[0] / wanted[0], (_at_zero(unit) - _at_zero(target)) / wanted[0]


def _plain(text: str) -> str:
    """Return a unit in letters, with * between all factors."""
    for symbol, plain in _SYMBOLS.items():
        text = text.replace(symbol, plain)
    return "*".join(re.sub(r"\s*([*/])\s*", r"\1", text).split())


def _at_zero(text: str) -> Fraction:
    """Return the temperature at zero, K; of a product, where a degree is a difference, nothing."""
    name = _plain(text)
    return _AT_ZERO.get(_SPELLINGS.get(name, name), Fraction(0))


def _parsed(text: str) -> Measure | None:
    """Return what a product of units measures; None when it is none."""
    if len(text) > LONGEST:
        return None
    factor, powers = Fraction(1), Counter[str]()
    parts = re.split("([*/])", f"*{_plain(text)}")[1:]
    for sign, term in zip(parts[::2], parts[1::2], strict=True):
        found = _TERM.fullmatch(term)
        measure = None if found is None else _named(found[1])
        if found is None or measure is None:
            return None
        power = int(found[2] or 1) * (1 if sign == "*" else -1)
        factor *= measure[0] ** power
        powers.update({name: n * power for name, n in measure[1].items()})
    return factor, {name: n for name, n in powers.items() if n}


def _named(name: str) -> Measure | None:
    """Return what one name means, which may be spelt out or have a prefix."""
    name = _SPELLINGS.get(name, name)
    if name in _BASE:
        return Fraction(1), {name: 1}
    size: str | int | Fraction
    if name in _UNITS:
        size, of = _UNITS[name]
        whole = _parsed(of) if of else (Fraction(1), {})
    elif name[0] in _PREFIXES and len(name) > 1:
        size, whole = _PREFIXES[name[0]], _named(name[1:])
    else:
        return None
    return whole and (whole[0] * Fraction(size), whole[1])


class Unit(NamedTuple):
    """A unit of a table: value in `target` = factor * value + offset."""

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
    bare, count = _without_count(text)
    if not count:
        raise ValueError(f"{text!r} is not a unit")
    factor, offset = exact_conversion(bare, target)
    return Unit(target, factor / count, offset)


def parse_own_unit(text: str) -> Unit:
    """Parse a unit that is kept, whatever it measures; of raw counts, the one that is divided.

    Raises ValueError when it is unknown, or not a unit.
    """
    bare, _ = _without_count(text)
    if _parsed(bare) is None:
        raise ValueError(f"unit {bare[:LONGEST]!r} is not known; usual here: V, A, rpm, degC; or 1")
    return parse_unit(text, bare)


def _without_count(text: str) -> tuple[str, Fraction]:
    """Split "g/16384" into the unit and how many counts are one of it."""
    counted = _COUNTED.fullmatch(text) if len(text) <= 2 * LONGEST else None
    if counted and _parsed(text) is None:
        return counted["unit"], Fraction(counted["count"])
    return text, Fraction(1)
