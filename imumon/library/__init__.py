"""imumon as a library: live samples of a port, recordings as tables, stages of one's own.

Everything here is what the command line is made of; the names that `import imumon` offers stay.
"""

import math
from collections.abc import Sequence
from typing import Any

from imumon.errors import bad_config


def require(ok: bool, name: str, value: object, expected: str) -> None:
    """Raise BAD_CONFIG, naming an argument, when it is not what was expected."""
    if not ok:
        raise bad_config(f"{name}={value!r:.60}: expected {expected}")


def require_list(name: str, value: object, expected: str) -> None:
    """Raise BAD_CONFIG unless an argument is a list or tuple."""
    require(isinstance(value, Sequence) and not isinstance(value, str | bytes), name, value, expected)


def require_seconds(name: str, value: Any, expected: str) -> None:
    """Raise BAD_CONFIG unless an argument is None or a finite number that is not negative."""
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    require(value is None or (number and value >= 0), name, value, f"a number of seconds {expected}, or None")
