"""What devices send instead of a time or a quaternion, as hidden columns for the encoders."""

from __future__ import annotations

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, IntArray


def date_of(prefix: str, time_ns: IntArray) -> dict[str, ColumnArray]:
    """Return the date and the time of day of Unix times, ns."""
    moments = [
        moment.timetuple()[:6] for moment in time_ns.astype("datetime64[ns]").astype("datetime64[s]").tolist()
    ]
    names = ("year", "month", "day", "hour", "minute", "second")
    parts = {
        f"_{prefix}{name}": np.array(values)
        for name, values in zip(names, zip(*moments, strict=True), strict=True)
    }
    return {**parts, f"_{prefix}of_second": time_ns % 1_000_000_000}


def matrix_of(q: FloatArray) -> dict[str, ColumnArray]:
    """Return the rotation matrix, reference to body, of quaternions body to reference, (4, n)."""
    w, x, y, z = q
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y),
        2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x),
        2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return {f"_matrix_{k // 3 + 1}{k % 3 + 1}": values for k, values in enumerate(rows)}
