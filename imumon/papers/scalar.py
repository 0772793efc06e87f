"""What the filters of one axis take."""

from __future__ import annotations

import numpy as np

from imumon.blocks import BoolArray, FloatArray


def samples(
    reading: FloatArray, measured: BoolArray | None, steps: FloatArray | None
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Return readings, which of them are used, and the time since the last sample in intervals, (n,) each.

    Parameters
    ----------
    reading : array, (n,)
        Data; predicted only where it is NaN or not `measured`.
    measured : array of bool, (n,), optional
        Whether the sample may be learnt from: the unit is at rest.  Default always.
    steps : array, (n,), optional
        Time since the last sample in sampling intervals.  Default 1.
    """
    use = np.isfinite(reading) if measured is None else measured & np.isfinite(reading)
    return reading, use, np.ones(len(reading)) if steps is None else steps
