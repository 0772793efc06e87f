"""The heading of a stationary unit from the whole stationary interval.

It is a constant, so it is the result of one fit to all samples of the interval, and no backward filter is
needed: warm-up and a settling tripod are models that only run forward.  A fit to the second half of the
interval alone tests it against the estimate at its middle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from imumon.blocks import IntArray, SampleBlock
from imumon.estimation.alignment.report import PositionHeading
from imumon.estimation.alignment.stage import Alignment
from imumon.estimation.smoothing.combine import SUSPECT, Smoothed
from imumon.estimation.smoothing.record import SENSORS, Record


def still_heading(
    record: Record, positions: Sequence[PositionHeading], later: Callable[[], Alignment]
) -> Smoothed:
    """Return the heading of each slot in which the unit stood still, rad, (n,); NaN elsewhere.

    Parameters
    ----------
    positions : sequence of PositionHeading
        As the alignment of the whole recording left them.
    later : callable
        Makes a new stage, for the second half of a position.
    """
    value, sd = np.full((2, len(record.run)), np.nan)
    residuals = []
    for position in positions:
        run = np.flatnonzero(record.run == position.run)
        since_s = 1e-9 * (record.middle_ns[run] - record.middle_ns[run[:1]])
        rows = run[(since_s >= position.begun_s) & (since_s <= position.ended_s)]
        if len(rows):
            residuals.append(_halves_differ(record, rows[len(rows) // 2 :], later()))
            value[rows], sd[rows] = position.heading, position.sd
            if residuals[-1] > SUSPECT:
                sd[rows] *= residuals[-1]
    known = [residual for residual in residuals if math.isfinite(residual)]
    return Smoothed(value, sd, float(np.sqrt(np.mean(np.square(known)))) if known else math.nan)


def _halves_differ(record: Record, rows: IntArray, stage: Alignment) -> float:
    """Return the normalised residual of the heading from these rows and that from earlier rows."""
    columns = {name: record.columns[name][rows] for name in SENSORS}
    at_rest = (record.columns["at_rest"][rows] == 1.0).astype(np.int64)
    times = {"device_time_ns": record.middle_ns[rows], "segment": record.run[rows], "at_rest": at_rest}
    found = stage.process(SampleBlock({**times, **columns}))
    before, before_sd = (float(record.columns[name][rows[0]]) for name in ("heading", "heading_sd"))
    after, after_sd = (float(found[name][-1]) for name in ("heading", "heading_sd"))
    difference = math.remainder(before - after, 2.0 * math.pi) if math.isfinite(before + after) else math.nan
    return abs(difference) / math.hypot(before_sd, after_sd)
