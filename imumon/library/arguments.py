"""Arguments of the wrong type or value are refused with one error that names the argument."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from imumon.errors import ImumonError, Reason


def refuse(name: str, value: object, expected: str) -> ImumonError:
    """Return the error BAD_CONFIG for an argument that is not what was expected."""
    return ImumonError(Reason.BAD_CONFIG, f"{name}={value!r:.60}: expected {expected}")


def expect(name: str, value: object, kinds: type | tuple[type, ...], expected: str) -> None:
    """Raise BAD_CONFIG unless the argument is of one of these types; None must be among them."""
    if not isinstance(value, kinds) or (isinstance(value, bool) and kinds is not bool):
        raise refuse(name, value, expected)


def expect_seconds(name: str, value: object, *, positive: bool = False) -> None:
    """Raise BAD_CONFIG unless the argument is None or a finite number that is not negative."""
    if value is None:
        return
    expected = f"a number of seconds {'above 0' if positive else 'from 0 on'}, or None"
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise refuse(name, value, expected)
    if value < 0 or (positive and value == 0):
        raise refuse(name, value, expected)


def expect_list(name: str, value: Any, expected: str) -> None:
    """Raise BAD_CONFIG unless the argument is a list or tuple."""
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        raise refuse(name, value, expected)
