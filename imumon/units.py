"""Units at the boundary: from what a device or a table has to what imumon has inside."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

from imumon.blocks import FloatArray
from imumon.errors import ImumonError, Reason

_PI = Fraction("3.1415926535897932384626433832795028841971693993751")
_BASE = {"rad", "s", "m", "kg", "A", "K"}
"""What all others are made of.  An angle is one of them: a Hz is not a rad/s."""

_UNITS: Mapping[str, tuple[str | int | Fraction, str]] = {
    "1": (1, ""),
    "g": ("9.80665", "m/s^2"),  # in this field never a gram
    "gram": ("0.001", "kg"),
    "deg": (_PI / 180, "rad"),
    "dps": (1, "deg/s"),
    "turn": (360, "deg"),
    "rpm": (1, "turn/min"),
    "arcmin": (Fraction(1, 60), "deg"),
    "arcsec": (Fraction(1, 60), "arcmin"),
    "min": (60, "s"),
    "h": (60, "min"),
    "day": (24, "h"),
    "Hz": (1, "1/s"),
    "N": (1, "kg*m/s^2"),
    "J": (1, "N*m"),
    "W": (1, "J/s"),
    "V": (1, "W/A"),
    "ohm": (1, "V/A"),
    "Pa": (1, "N/m^2"),
    "bar": (100_000, "Pa"),
    "atm": (101_325, "Pa"),
    "psi": (Fraction("4.4482216152605") / Fraction("0.0254") ** 2, "Pa"),
    "T": (1, "V*s/m^2"),
    "gauss": ("1e-4", "T"),
    "degC": (1, "K"),
    "degF": (Fraction(5, 9), "K"),
    "inch": ("0.0254", "m"),
    "ft": (12, "inch"),
    "knot": (1852, "m/h"),
    "%": ("0.01", ""),
    "ppm": ("1e-6", ""),
}
"""Each name: so many of a product of others."""

_AT_ZERO = {"degC": Fraction("273.15"), "degF": Fraction("459.67") * 5 / 9}
"""The temperature at zero, in K, of scales that do not begin there."""

_PREFIXES = {
    "n": "1e-9", "u": "1e-6", "m": "1e-3", "c": "1e-2", "h": "100", "k": "1000", "M": "1e6",
    "nano": "1e-9", "micro": "1e-6", "milli": "1e-3", "centi": "1e-2", "kilo": "1000", "mega": "1e6",
}  # fmt: skip
_WITH_PREFIX = {
    "rad",
    "s",
    "m",
    "A",
    "K",
    "g",
    "deg",
    "dps",
    "Hz",
    "N",
    "J",
    "W",
    "V",
    "ohm",
    "Pa",
    "bar",
    "T",
    "gauss",
}

_SPELLINGS = {
    "G": "gauss", "mG": "mgauss", "Gauss": "gauss", "tesla": "T",
    "C": "degC", "celsius": "degC", "F": "degF", "kelvin": "K",  # in this field C is never a coulomb
    "sec": "s", "second": "s", "seconds": "s", "minute": "min", "minutes": "min",
    "hr": "h", "hour": "h", "hours": "h", "d": "day", "days": "day",
    "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "rev": "turn",
    "meter": "m", "metre": "m", "in": "inch", "kt": "knot", "volt": "V", "ampere": "A", "hertz": "Hz",
    "standard_gravity": "g", "percent": "%", "count": "1", "counts": "1",
}  # fmt: skip
_SYMBOLS = {
    "°C": "degC",
    "°F": "degF",
    "°": "deg",
    "µ": "u",
    "μ": "u",
    "Ω": "ohm",
    "²": "^2",
    "³": "^3",
    "·": "*",
}

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
_SEPARATOR = re.compile(r"\s*([*/])\s*|\s+")
_TERM = re.compile(r"([*/]?)([A-Za-z_]+|%|1)(?:(?:\^|\*\*)(-?[1-9]))?(?![\w^])", re.ASCII)
"""One part of a product: its sign, its name and its power."""


class _Measure(NamedTuple):
    """How many of which product of base units a unit is, and its temperature at zero in K."""

    factor: Fraction
    powers: Mapping[str, int]
    at_zero: Fraction = Fraction(0)


@lru_cache(maxsize=256)
def exact_conversion(unit: str, target: str) -> tuple[Fraction, Fraction]:
    """Return (factor, offset), not rounded, so that value_in_target = factor * value_in_unit + offset.

    Raises BAD_CONFIG when the unit is unknown or measures something else than the target.
    """
    given, wanted = _measure(unit), _measure(target)
    if given is None:
        what = f"unit {unit[:LONGEST]!r} is not known"
        raise ImumonError(Reason.BAD_CONFIG, what, f"expected one like {target!r}")
    if wanted is None or given.powers != wanted.powers:
        what = f"unit {unit!r} does not measure what {target!r} measures"
        raise ImumonError(Reason.BAD_CONFIG, what, f"expected one like {EXAMPLES.get(target, target)}")
    return given.factor / wanted.factor, (given.at_zero - wanted.at_zero) / wanted.factor


@lru_cache(maxsize=256)
def _measure(text: str) -> _Measure | None:
    """Return what a product of units is; None when it is none.

    In a product a degree is a difference of temperatures: of degC/s only the factor counts.
    """
    if len(text) > LONGEST:
        return None
    for symbol, plain in _SYMBOLS.items():
        text = text.replace(symbol, plain)
    text = _SEPARATOR.sub(lambda found: found[1] or "*", text.strip())
    factor, powers, at = Fraction(1), Counter[str](), 0
    while at < len(text):
        term = _TERM.match(text, at)
        part = _named(term[2]) if term is not None else None
        if term is None or part is None or (at == 0) != (not term[1]):
            return None
        power = int(term[3] or 1) * (-1 if term[1] == "/" else 1)
        factor *= part.factor**power
        powers.update({name: n * power for name, n in part.powers.items()})
        at = term.end()
    at_zero = _AT_ZERO.get(_SPELLINGS.get(text, text), Fraction(0))
    return _Measure(factor, {name: n for name, n in powers.items() if n}, at_zero) if text else None


def _named(name: str) -> _Measure | None:
    """Return what one name means, which may be spelt out or have a prefix."""
    name = _SPELLINGS.get(name, name)
    if name in _BASE:
        return _Measure(Fraction(1), {name: 1})
    if name in _UNITS:
        size, parts = _UNITS[name]
        whole = _measure(parts) if parts else _Measure(Fraction(1), {})
        return whole and whole._replace(factor=whole.factor * Fraction(size))
    for prefix, size in _PREFIXES.items():
        rest = name.removeprefix(prefix)
        rest = _SPELLINGS.get(rest, rest)
        if name.startswith(prefix) and rest in _WITH_PREFIX:
            whole = _named(rest)
            return whole and whole._replace(factor=whole.factor * Fraction(size))
    return None


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
    bare, count = _without_count(text)
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
    bare, _ = _without_count(text)
    if _measure(bare) is None:
        raise ValueError(f"unit {bare[:LONGEST]!r} is not known; usual here: V, A, rpm, degC; or 1")
    return parse_unit(text, bare)


def _without_count(text: str) -> tuple[str, Fraction]:
    """Split "g/16384" into the unit and how many counts are one of it."""
    counted = _COUNTED.fullmatch(text)
    if counted and _measure(text) is None:
        return counted["unit"], Fraction(counted["count"])
    return text, Fraction(1)
