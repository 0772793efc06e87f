"""Times of foreign tables, from text to integer nanoseconds."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation

from imumon.recordings.map import TIMESTAMPS
from imumon.units import parse_unit

ParseTime = Callable[[str], int]


def time_parser(unit: str, date_format: str | None = None) -> ParseTime:
    """Return a function from the text of a time to integer nanoseconds, without rounding through floats.

    The function raises ValueError for text that is no time, or out of the range of int64.
    """
    if date_format is not None:
        return _date_parser(date_format)
    if unit == TIMESTAMPS:
        return _parse_timestamp
    factor = parse_unit(unit, "ns").factor
    scale = Decimal(factor.numerator) / Decimal(factor.denominator)

    def parse(text: str) -> int:
        if "_" in text:  # which Decimal accepts, but no table means
            raise ValueError(f"time {text.strip()!r} is not a number")
        try:
            value = Decimal(text) * scale
        except InvalidOperation as error:
            raise ValueError(f"time {text.strip()!r} is not a number") from error
        except ArithmeticError as error:
            raise ValueError(f"time {text.strip()!r} is out of range") from error
        if not value.is_finite() or abs(value) >= 2**63:
            raise ValueError(f"time {text.strip()!r} is out of range")
        return int(value.to_integral_value())

    return parse


_TIMESTAMP = re.compile(
    r"\s*(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?\s*(Z|UTC|[+-]\d\d:?\d\d)?\s*", re.ASCII
)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def _parse_timestamp(text: str) -> int:
    """Return Unix time in ns; a time without zone is UTC."""
    match = _TIMESTAMP.fullmatch(text)
    if match is None:
        raise ValueError(f"time {text.strip()!r} is not a date with time, as 2026-01-31T12:00:00.5Z")
    date, time, fraction, zone = match.groups()
    zone = "+00:00" if zone in (None, "Z", "UTC") else zone
    moment = datetime.fromisoformat(f"{date}T{time}{zone}")
    return _unix_ns(moment, int((fraction or "").ljust(9, "0")), text)


def _date_parser(date_format: str) -> ParseTime:
    """Return `time_parser` of dates in a format of `datetime.strptime`."""

    def parse(text: str) -> int:
        try:
            moment = datetime.strptime(text.strip(), date_format)
        except ValueError as error:
            raise ValueError(f"time {text.strip()!r} is not as {date_format!r}") from error
        return _unix_ns(moment if moment.tzinfo else moment.replace(tzinfo=UTC), 0, text)

    return parse


def _unix_ns(moment: datetime, more_ns: int, text: str) -> int:
    since = moment - _EPOCH
    time_ns = ((since.days * 86_400 + since.seconds) * 10**6 + since.microseconds) * 1000 + more_ns
    if not abs(time_ns) < 2**63:
        raise ValueError(f"time {text.strip()!r} is out of range")
    return time_ns
