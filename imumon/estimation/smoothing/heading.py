"""The heading of a stationary unit from the whole stationary interval.

It is a constant, so it is the result of one fit to all samples of the interval, and no backward filter is
needed: warm-up and a settling tripod are models that only run forward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.estimation.alignment.report import PositionHeading
from imumon.estimation.smoothing.record import Record
from imumon.estimation.smoothing.stage import Smoothed


def still_heading(record: Record, positions: Sequence[PositionHeading]) -> Smoothed:
    """Return the heading of each slot in which the unit stood still, rad, (n,); NaN elsewhere.

    Parameters
    ----------
    positions : sequence of PositionHeading
        As the alignment of the whole recording left them.
    """
    value, sd = np.full((2, len(record.run)), np.nan)
    for position in positions:
        run = np.flatnonzero(record.run == position.run)
        since_s = 1e-9 * (record.middle_ns[run] - record.middle_ns[run[:1]])
        rows = run[(since_s >= position.begun_s) & (since_s <= position.ended_s)]
        value[rows], sd[rows] = position.heading, position.sd
    return Smoothed(value, sd, math.nan)
