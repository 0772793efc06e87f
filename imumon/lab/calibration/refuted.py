"""Whether a session that was left out refutes the curves, before an autopilot flies with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.errors import ImumonError, Reason
from imumon.lab.calibration.calibration import calibrate
from imumon.lab.calibration.cells import channel_of, group, levels
from imumon.lab.calibration.record import Record

LEAST_LEVELS = 4
"""Of fewer means a line with its standard deviation says nothing."""
SURE = 2.0
"""Standard deviations."""
HALF = 0.5
"""Where less of a curve than this is there, no curve errs less than it does."""


@dataclass(frozen=True, slots=True)
class Followed:
    """How much of a channel's curve a session has that was left out: 1 all of it, 0 nothing; and its sd."""

    channel: str
    share: float
    sd: float


def check_last(records: Sequence[Record], latitude_deg: float | None, heading_deg: float | None) -> list[str]:
    """Compare curves made without the last record with that one; return what is to be said.

    Raises BAD_DATA when some curve errs more in it than no curve does.
    """
    if len(records) < 2:
        return []
    try:
        found = followed(records, latitude_deg, heading_deg)
    except ImumonError as error:
        return [f"that the model holds in another session is not shown: without the last one, {error.seen}"]
    wrong = [one for one in found if one.share + SURE * one.sd < HALF]
    if wrong:
        shares = ", ".join(f"{one.channel} {one.share:.2f} ± {one.sd:.2f}" for one in wrong)
        raise ImumonError(
            Reason.BAD_DATA,
            f"the last session refutes curves made of the others: of these it has {shares}; below {HALF:g} no"
            " curve errs less",
            "let imumon diagnose say what is missing, and leave out what was recorded otherwise",
        )
    return []


def followed(
    records: Sequence[Record], latitude_deg: float | None, heading_deg: float | None
) -> list[Followed]:
    """Return how much of the curves made without the last record that one has, by the means of its levels.

    Raises ImumonError as `calibrate`, of the records without the last.
    """
    model = calibrate(records[:-1], latitude_deg, heading_deg).model
    last = records[-1:]
    cells = group(last, latitude_deg, heading_deg)
    found = []
    for name, known in model.channels.items():
        channel = channel_of(last, cells, name, levels(cells))
        if channel is None:
            continue
        points = channel.points()
        low, high = known.temperature_range_degc
        points = points.only((points.temperature >= low) & (points.temperature <= high))
        curve, value = (
            _by_level(points.level, points.weight, values)
            for values in (known.value(points.temperature), points.value)
        )
        if len(curve) >= LEAST_LEVELS:
            found.append(Followed(name, *_share(curve - curve.mean(), value - value.mean())))
    return found


def _by_level(level: IntArray, weight: FloatArray, values: FloatArray) -> FloatArray:
    """Return the mean of each level, (m,): what drifts slowly within one is not many means."""
    _, which = np.unique(level, return_inverse=True)
    total = np.bincount(which, weight)
    return np.asarray(np.bincount(which, weight * values) / total)


def _share(curve: FloatArray, value: FloatArray) -> tuple[float, float]:
    """Return the slope of values over the curve, both without their means, and its standard deviation."""
    size = float(curve @ curve)
    if size == 0.0:
        return 1.0, np.inf  # a curve that is flat errs as much as none
    share = float(curve @ value) / size
    left = value - share * curve
    return share, float(np.sqrt(left @ left / (len(curve) - 2) / size))
